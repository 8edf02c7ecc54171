"""The script of a report: headers that sort their table, the section in sight marked in the contents, paper all open.

Without it everything can be read.

How a report looks: light or dark as the reader's system is, on a desk, on a phone, on paper.
"""

from __future__ import annotations

import base64
import hashlib

__all__ = ["POLICY", "SCRIPT", "STYLE"]

SCRIPT = """\
(function () {
  "use strict";
  function value(row, column, numeric) {
    var text = row.cells[column].textContent;
    return numeric ? parseFloat(text.replace("inf", "Infinity")) : text;
  }
  function compare(a, b) {
    if (typeof a === "number") {
      // what is no number comes last, whichever way
      return (isNaN(a) - isNaN(b)) || a - b;
    }
    return a.localeCompare(b, undefined, {numeric: true});
  }
  document.querySelectorAll("table.sort").forEach(function (table) {
    var body = table.tBodies[0], given = Array.from(body.rows), heads = Array.from(table.tHead.rows[0].cells);
    if (given.length < 2) { return; }
    heads.forEach(function (head, column) {
      var button = document.createElement("button"), numeric = head.classList.contains("n");
      button.type = "button";
      button.title = "sort";
      while (head.firstChild) { button.appendChild(head.firstChild); }
      head.appendChild(button);
      button.addEventListener("click", function () {
        var before = head.getAttribute("aria-sort");
        var order = before === "ascending" ? "descending" : before === "descending" ? null : "ascending";
        var sign = order === "descending" ? -1 : 1, rows = given.slice();
        heads.forEach(function (other) { other.removeAttribute("aria-sort"); });
        if (order) {
          head.setAttribute("aria-sort", order);
          rows.sort(function (a, b) {
            var x = value(a, column, numeric), y = value(b, column, numeric);
            return numeric && (isNaN(x) || isNaN(y)) ? compare(x, y) : sign * compare(x, y);
          });
        }
        rows.forEach(function (row) { body.appendChild(row); });
      });
    });
  });
  // only what scrolls is a stop of the Tab key
  function reach() {
    document.querySelectorAll(".scroll").forEach(function (box) {
      var scrolls = box.scrollWidth > box.clientWidth + 1 || box.scrollHeight > box.clientHeight + 1;
      if (scrolls) { box.tabIndex = 0; } else { box.removeAttribute("tabindex"); }
    });
  }
  reach();
  window.addEventListener("resize", reach);
  document.addEventListener("toggle", reach, true);
  // the section that the upper part of the window shows
  var sections = Array.from(document.querySelectorAll("section[id]"));
  function mark() {
    var line = 0.2 * window.innerHeight;
    sections.forEach(function (section) {
      var at = section.getBoundingClientRect();
      var link = document.querySelector('.contents a[href="#' + section.id + '"]');
      if (at.top <= line && line < at.bottom) { link.setAttribute("aria-current", "true"); }
      else { link.removeAttribute("aria-current"); }
    });
  }
  mark();
  ["scroll", "resize"].forEach(function (name) { window.addEventListener(name, mark); });
  document.addEventListener("toggle", mark, true);
  var closed = [];
  window.addEventListener("beforeprint", function () {
    closed = Array.from(document.querySelectorAll("details:not([open])"));
    closed.forEach(function (part) { part.open = true; });
  });
  window.addEventListener("afterprint", function () {
    closed.forEach(function (part) { part.open = false; });
  });
})();
"""

_HASH = base64.b64encode(hashlib.sha256(f"\n{SCRIPT}".encode()).digest()).decode()

#: what the page may load or run: pictures inside it, its style, and this one script
POLICY = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{_HASH}'"


_COLOURS = """\
:root {
  color-scheme: light dark;
  --ink: #1f2328; --soft: #59636e; --line: #d7dce2; --page: #ffffff; --band: #f5f7f9; --link: #0061a4;
}
@media (prefers-color-scheme: dark) {
  :root { --ink: #e3e7eb; --soft: #9aa4af; --line: #3a4149; --page: #16191d; --band: #1e2227; --link: #6cb6f2; }
}
"""

_PAGE = """\
* { box-sizing: border-box; }
html { scroll-padding-top: .8rem; -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.5 system-ui, sans-serif;
  overflow-wrap: break-word; }
main { max-width: 104rem; margin: 0 auto; padding: .9rem clamp(.8rem, 2vw, 2rem) 3rem; }
h1 { font-size: 1.45rem; line-height: 1.25; margin: 0 0 .2rem; }
h2 { display: flex; justify-content: space-between; align-items: baseline; gap: 1rem; font-size: 1.35rem;
  line-height: 1.3; margin: 2.4rem 0 .5rem; padding-top: .8rem; border-top: 2px solid var(--line); }
p { margin: .45rem 0; max-width: 54rem; text-wrap: pretty; }
main > p { max-width: none; }
/* each text is written in the direction of its own letters */
h1, h2, p, dd, summary, figcaption, th, td { unicode-bidi: plaintext; }
a { color: var(--link); text-decoration: none; }
a:hover, a:focus { text-decoration: underline; }
:focus-visible { outline: 2px solid var(--link); outline-offset: 2px; border-radius: 2px; }
h2 a.up { font-size: .85rem; font-weight: 400; }
.columns { columns: 32rem auto; column-gap: 2.5rem; margin: .45rem 0; }
.columns p { max-width: none; orphans: 2; widows: 2; }
.columns p:first-child { margin-top: 0; }
.note, .same, .count, .unit, figcaption { color: var(--soft); }
.note, .same, figcaption { font-size: .9rem; }
.count { font-weight: 400; font-size: .85rem; white-space: nowrap; }
.unit, .whole { white-space: nowrap; }
.unit { font-weight: 400; }
summary { cursor: pointer; }
details.more { margin: .2rem 0 .6rem; font-size: .92rem; }
details.more > summary { color: var(--link); width: max-content; }
dl { display: grid; grid-template-columns: minmax(7rem, max-content) 1fr; gap: .25rem 1.2rem; font-size: .9rem; }
dt { color: var(--soft); } dd { margin: 0; min-width: 0; overflow-wrap: anywhere; }
"""

_CONTENTS = """\
.contents ol { margin: .4rem 0; padding-left: 1.7rem; columns: 22rem auto; column-gap: 2rem; }
.contents li { break-inside: avoid; padding: .15rem 0; }
.contents li.last { list-style: none; }
@media screen and (min-width: 100rem) {
  /* beside the page, always in sight */
  main { max-width: 118rem; padding-left: 17rem; }
  .contents { position: fixed; top: 0; bottom: 0; left: max(1rem, calc(50vw - 58rem)); width: 14rem; overflow-y: auto;
    padding: 1rem .5rem 1rem 0; font-size: .9rem; line-height: 1.35; }
  .contents::before { content: "Contents"; font-weight: 600; }
  .contents ol { columns: auto; padding-left: 1.6rem; }
  .contents li { padding: .25rem 0; }
  .contents a[aria-current] { color: var(--ink); font-weight: 600; }
  h2 a.up { display: none; }
}
"""

_FRONT = """\
.front { display: grid; grid-template-columns: repeat(6, minmax(0, 1fr)); gap: .7rem; margin: .6rem 0 1.2rem; }
.card { grid-column: span 2; border: 1px solid var(--line); border-radius: 6px; padding: .45rem .7rem .4rem;
  min-width: 0; }
.card.wide { grid-column: span 3; }
.card h2 { font-size: 1rem; margin: 0 0 .1rem; padding: 0; border: 0; }
.card p { font-size: .84rem; line-height: 1.36; margin: .25rem 0; }
.card .columns { margin: 0; columns: auto; }
.card details.more { margin: 0 0 .2rem; font-size: .84rem; }
.card table { font-size: .8rem; }
.card th, .card td { padding: .14rem .4rem; }
.card .paper { padding: 0; }
/* so high that both rows of cards stand on one screen */
.card .paper svg, .card .paper img { width: 100%; height: clamp(11rem, calc(100vh - 33.5rem), 17rem);
  object-fit: contain; }
.card.absent { border-style: dashed; color: var(--soft); align-self: start; }
@media screen and (max-width: 68rem) { .card, .card.wide { grid-column: span 3; } }
@media screen and (max-width: 46rem) {
  .card, .card.wide { grid-column: span 6; }
  .card .paper svg, .card .paper img { height: auto; }
}
@media screen and (max-width: 23rem) { .card th, .card td { padding: .14rem .22rem; } }
"""

_TABLES = """\
details.table { border: 1px solid var(--line); border-radius: 6px; margin: .7rem 0; padding: 0 .8rem; }
details.table > summary { padding: .45rem 0; }
details.table[open] > summary { font-weight: 600; }
details.table[open] { padding-bottom: .4rem; }
.scroll { overflow-x: auto; max-width: 100%; }
.scroll.tall { overflow-y: auto; max-height: min(44rem, 85vh); }
table { border-collapse: separate; border-spacing: 0; font-size: .84rem; line-height: 1.35; min-width: 100%;
  font-variant-numeric: tabular-nums; }
table.narrow { min-width: min(100%, 48rem); }
th, td { padding: .22rem .5rem; text-align: left; vertical-align: baseline; }
td, tbody th { background: var(--page); max-width: 22rem; }
table.wide td:not(.n) { min-width: 9rem; }
.parts { display: none; }
tbody tr:nth-child(even) > * { background: var(--band); }
th.n, td.n { text-align: right; }
tbody .n { white-space: nowrap; }
/* what a number lacks of the widest fraction of its column: decimal points stand below each other */
[data-pad]::after { content: attr(data-pad); visibility: hidden; }
thead th { border-bottom: 2px solid var(--soft); vertical-align: bottom; background: var(--page); }
.tall thead th { position: sticky; top: 0; z-index: 1; }
tbody th { font-weight: 400; }
tr > :first-child { position: sticky; left: 0; z-index: 1; border-right: 1px solid var(--line); min-width: 5.6rem; }
.tall thead tr > :first-child { z-index: 2; }
tbody tr:last-child > * { border-bottom: 1px solid var(--line); }
th button { font: inherit; color: inherit; background: none; border: 0; padding: 0; margin: 0; text-align: inherit;
  cursor: pointer; }
th button:hover { color: var(--link); }
/* the mark stands in the gap between columns, so that none moves */
th button::after { position: absolute; margin-left: .1rem; font-size: .62rem; font-weight: 400; line-height: 1.35rem; }
th:not([aria-sort]) button:hover::after { content: "\\\\2195"; }
th[aria-sort="ascending"] button::after { content: "\\\\25b2"; }
th[aria-sort="descending"] button::after { content: "\\\\25bc"; }
"""

_PICTURES = """\
/* --w is the width that a picture was drawn for; a little narrower, two may stand side by side */
.pictures { display: flex; flex-wrap: wrap; gap: 1rem 1.5rem; align-items: flex-start; margin: 1rem 0; }
figure { margin: 0; min-width: 0; flex: 1 1 calc(.8 * var(--w)); max-width: min(100%, calc(var(--w) + .6rem)); }
figcaption { margin: .3rem 0; max-width: 46rem; }
/* drawings are made for white paper, and stay on it in the dark */
.paper { background: #ffffff; border-radius: 4px; overflow-x: auto; padding: .3rem; }
.paper svg, .paper img { display: block; width: 100%; height: auto; }
.paper svg * { stroke-linejoin: round; stroke-linecap: butt; }
@media (prefers-color-scheme: dark) { .paper { filter: brightness(.9); } }
@media screen and (max-width: 46rem) {
  figure .paper svg, figure .paper img { width: min(var(--w), max(100%, .65 * var(--w))); }
}
"""

_PRINT = """\
@page { size: A4 landscape; margin: 12mm; }
@media print {
  :root { color-scheme: light; --ink: #000000; --soft: #444444; --line: #bbbbbb; --page: #ffffff; --band: #f5f7f9;
    --link: #000000; }
  html { font-size: 11px; }
  body { font-size: 1rem; }
  main { max-width: none; padding: 0; }
  details::details-content { content-visibility: visible; display: block; }
  details > summary { list-style: none; }
  details.more > summary, h2 a.up, .note.file, .contents .last { display: none; }
  .scroll, .scroll.tall { overflow: visible; max-height: none; }
  table { font-size: 6.6pt; min-width: 0; width: 100%; }
  .parts { display: block; }
  .parts table { margin-bottom: 1rem; }
  table.wide { display: none; }
  th, td { padding: 1pt 3pt; }
  .l { overflow-wrap: anywhere; min-width: 14em; }
  tr > :first-child, .tall thead th { position: static; }
  .card .paper svg, .card .paper img { height: 14rem; }
  figure { flex: none; max-width: 100%; }
  .paper { filter: none; }
  figure .paper svg, figure .paper img { width: min(100%, .72 * var(--w)); max-height: 155mm; object-fit: contain; }
  tr, dl, figure, .card, .columns, summary, details.table:not(.long) { break-inside: avoid; }
  /* on later pages a head would be repeated without its buttons */
  th button { display: contents; }
  h2, h2 + p, h2 + .columns, summary, .same, thead { break-after: avoid; }
}
"""

STYLE = "".join((_COLOURS, _PAGE, _CONTENTS, _FRONT, _TABLES, _PICTURES, _PRINT)).replace("\\\\", "\\")
