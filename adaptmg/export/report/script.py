"""The script of a report: headers that sort their table, the section in sight marked in the contents, paper all open.

Without it everything can be read.
"""

from __future__ import annotations

import base64
import hashlib

__all__ = ["POLICY", "SCRIPT"]

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
