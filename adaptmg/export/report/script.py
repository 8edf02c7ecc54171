"""The script of a report: headers that sort their table, and everything open on paper. Without it all can be read."""

from __future__ import annotations

import base64
import hashlib

__all__ = ["POLICY", "SCRIPT"]

SCRIPT = """\
(function () {
  "use strict";
  function value(row, column, numeric) {
    var text = row.cells[column].textContent;
    return numeric ? parseFloat(text) : text;
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
