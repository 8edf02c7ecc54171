"""How a report looks: light or dark as the reader's system is, on a desk, on a phone, on paper."""

from __future__ import annotations

__all__ = ["STYLE"]

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
main { max-width: 104rem; margin: 0 auto; padding: 1.1rem clamp(.8rem, 2vw, 2rem) 3rem; }
h1 { font-size: 1.55rem; line-height: 1.25; margin: 0 0 .3rem; }
h2 { display: flex; justify-content: space-between; align-items: baseline; gap: 1rem; font-size: 1.35rem;
  line-height: 1.3; margin: 2.4rem 0 .5rem; padding-top: .8rem; border-top: 2px solid var(--line); }
p { margin: .45rem 0; max-width: 54rem; }
main > p { max-width: none; }
a { color: var(--link); text-decoration: none; }
a:hover, a:focus { text-decoration: underline; }
h2 a.up { font-size: .85rem; font-weight: 400; }
.columns { columns: 32rem auto; column-gap: 2.5rem; margin: .45rem 0; }
.columns p { max-width: none; }
.columns p:first-child { margin-top: 0; }
.note, .same, .count, .unit, figcaption { color: var(--soft); }
.note, .same, figcaption { font-size: .9rem; }
.count { font-weight: 400; font-size: .85rem; white-space: nowrap; }
.unit { font-weight: 400; }
summary { cursor: pointer; }
details.more { margin: .2rem 0 .6rem; font-size: .92rem; }
details.more > summary { color: var(--link); width: max-content; }
.contents ol { margin: .4rem 0; padding-left: 1.7rem; columns: 22rem auto; column-gap: 2rem; }
.contents li { break-inside: avoid; margin: .15rem 0; }
dl { display: grid; grid-template-columns: minmax(7rem, max-content) 1fr; gap: .25rem 1.2rem; font-size: .9rem; }
dt { color: var(--soft); } dd { margin: 0; min-width: 0; overflow-wrap: anywhere; }
"""

_FRONT = """\
.front { display: grid; grid-template-columns: repeat(6, minmax(0, 1fr)); gap: .8rem; margin: .8rem 0 1.4rem; }
.card { grid-column: span 2; border: 1px solid var(--line); border-radius: 6px; padding: .55rem .8rem .6rem;
  min-width: 0; }
.card.wide { grid-column: span 3; }
.card h2 { font-size: 1rem; margin: 0 0 .2rem; padding: 0; border: 0; }
.card p { font-size: .88rem; line-height: 1.4; margin: .3rem 0; }
.card table { font-size: .84rem; }
.card .paper svg { width: 100% !important; max-height: 15.5rem; }
.card.absent { border-style: dashed; color: var(--soft); align-self: start; }
@media (max-width: 68rem) { .card, .card.wide { grid-column: span 3; } }
@media (max-width: 46rem) { .card, .card.wide { grid-column: span 6; } }
"""

_TABLES = """\
details.table { border: 1px solid var(--line); border-radius: 6px; margin: .7rem 0; padding: 0 .8rem; }
details.table > summary { padding: .45rem 0; }
details.table[open] > summary { font-weight: 600; }
details.table[open] { padding-bottom: .4rem; }
.scroll { overflow-x: auto; max-width: 100%; }
.scroll.tall { overflow-y: auto; max-height: 44rem; }
table { border-collapse: separate; border-spacing: 0; font-size: .84rem; line-height: 1.35; min-width: 100%;
  font-variant-numeric: tabular-nums; }
table.narrow { min-width: min(100%, 48rem); }
th, td { padding: .22rem .5rem; text-align: left; vertical-align: baseline; }
td, tbody th { background: var(--page); max-width: 22rem; }
tbody tr:nth-child(even) > * { background: var(--band); }
th.n, td.n { text-align: right; }
td.n { white-space: nowrap; }
thead th { border-bottom: 1.5px solid var(--ink); vertical-align: bottom; background: var(--page); }
.tall thead th { position: sticky; top: 0; z-index: 1; }
tbody th { font-weight: 400; }
tr > :first-child { position: sticky; left: 0; z-index: 1; border-right: 1px solid var(--line); min-width: 5rem; }
.tall thead tr > :first-child { z-index: 2; }
tbody tr:last-child > * { border-bottom: 1px solid var(--line); }
th button { font: inherit; color: inherit; background: none; border: 0; padding: 0; margin: 0; text-align: inherit;
  cursor: pointer; }
th button:hover { color: var(--link); }
th[aria-sort="ascending"] button::after { content: " \\\\2191"; }
th[aria-sort="descending"] button::after { content: " \\\\2193"; }
"""

_PICTURES = """\
.pictures { display: flex; flex-wrap: wrap; gap: 1rem 1.5rem; align-items: flex-start; margin: 1rem 0; }
figure { margin: 0; min-width: 0; max-width: 100%; }
.pictures figure { flex: 0 1 auto; }
figcaption { margin: .3rem 0; max-width: 46rem; }
/* drawings are made for white paper, and stay on it in the dark */
.paper { background: #ffffff; border-radius: 4px; overflow-x: auto; padding: .3rem; }
.paper svg, .paper img { display: block; height: auto; max-width: 100%; }
.paper svg * { stroke-linejoin: round; stroke-linecap: butt; }
@media (max-width: 46rem) {
  .paper svg, .paper img { max-width: none; width: 34rem !important; }
  .card .paper svg { max-width: 100%; width: 100% !important; }
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
  details.more > summary, h2 a.up { display: none; }
  .scroll, .scroll.tall { overflow: visible; max-height: none; }
  table { font-size: 6.6pt; min-width: 0; width: 100%; }
  th, td { padding: 1pt 2.5pt; overflow-wrap: anywhere; }
  tr > :first-child { position: static; min-width: 0; }
  td.n { white-space: normal; }
  tr, figure, .card { break-inside: avoid; }
  thead { display: table-header-group; }
  h2, summary { break-after: avoid; }
}
"""

STYLE = "".join((_COLOURS, _PAGE, _FRONT, _TABLES, _PICTURES, _PRINT)).replace("\\\\", "\\")
