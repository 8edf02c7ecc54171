"""Reports in a browser: the first screen has the answers, nothing runs over, tables sort and fold,
paper has all."""

import re

import numpy as np
import pandas as pd
import pytest
from browser import dom, measure, needs_browser
from matplotlib.figure import Figure

import adaptmg as am

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A report with wide tables, long words and large pictures; its file."""
    report = am.export.Report(
        "A title of some length " * 5 + "averylongword" * 20, "Summary. " * 40
    )
    many = pd.DataFrame(
        {f"a column of number {k}": np.arange(90) * 10.0 ** (k - 8) for k in range(18)}
    )
    many.insert(0, "method", [f"{'long ' * (k % 7)}method{k}" for k in range(90)])
    for k in range(3):
        answers = pd.DataFrame(
            {
                "grids": ["a method of two words", "289/81", "1089/289/81/25", "another method"],
                "paper": [1.0, 7.2, 21.7, 27.3],
                "ours": np.arange(4) * 8.25,
                f"new {k}": 1.0,
            }
        )
        report.card(
            "Table",
            "What it says in words. " * 8,
            table=answers,
            units={"paper": "CPU", "ours": "work"},
        )
    for _ in range(2):
        report.card("Picture", "What it says, in words that are not few. " * 15, figure=drawing())
    report.section("Sorted")
    names = ["name", "a name of many words x", "a name of many words y"]
    report.table(
        pd.DataFrame([("b", 2e-3, -1.0), ("a10", None, -20.0), ("a9", 1e5, 3.0)], columns=names),
        "sorted",
    )
    for k in range(3):
        report.section(f"Section {k}", "Sentence of some words here. " * 50)
        report.table(many, "Wide " * 30, "Note of some words here. " * 60, csv="a.csv")
        report.figure(drawing(14), "caption " * 30)
        report.figure(drawing(4), "caption")
        report.table(many.head(5), "wide and short", open=True)
        report.table(pd.DataFrame({"x" * 200: ["y" * 300], "n": [1]}), "folded")
    return report.write(tmp_path_factory.mktemp("page") / "report.html")


def drawing(width: float = 6.0) -> Figure:
    figure = Figure(figsize=(width, 3))
    figure.subplots().plot([1, 2, 3])
    return figure


SCRIPT = """
function all(what) { return Array.from(document.querySelectorAll(what)); }
// what lies right of the window, but for what is in boxes that scroll
function over(inside) {
  var wide = document.documentElement.clientWidth;
  return {window: wide, page: document.documentElement.scrollWidth,
          cut: all(".scroll").filter(box => box.scrollHeight > box.clientHeight + 1).length,
          boxes: all(".scroll").filter(box => box.scrollWidth > box.clientWidth + 1).length,
          over: all("body *").filter(part => !part.closest(inside) && part.getBoundingClientRect().width > 0
                                     && part.getBoundingClientRect().right > wide + 1)
                             .map(part => part.tagName + "." + part.className)};
}
var found = {sorted: []};

var table = all("table").find(part => part.textContent.includes("a10"));
function click(k) {
  table.tHead.rows[0].cells[k].querySelector("button").click();
  found.sorted.push(Array.from(table.tBodies[0].rows).map(row => row.cells[0].textContent).join(" "));
}
[1, 1, 0, 0, 2].forEach(click);
found.order = Array.from(table.tHead.rows[0].cells).map(head => head.getAttribute("aria-sort"));

function opened() { return all("details[open]").length; }
found.open = [opened()];
["beforeprint", "afterprint"].forEach(function (name) {
  window.dispatchEvent(new Event(name));
  found.open.push(opened());
});
found.all = all("details").length;

all("details").forEach(function (part) { part.open = true; });
[390, 820, 1440].forEach(function (width) {
  resize(width);
  found[width] = over(".scroll table, .paper > *");
});

resize(1280, 800);
all(".card details").forEach(function (part) { part.open = false; });
found.front = document.querySelector(".front").getBoundingClientRect().height;
all(".card details").forEach(function (part) { part.open = true; });
var style = document.querySelector("style");
style.textContent = style.textContent.replace("@media print", "@media screen");
resize(1032);
found.paper = over(".paper > *");
found.still = all("th").filter(head => getComputedStyle(head).position !== "static").length;
found.cards = all(".card, .pictures figure").filter(part => part.getBoundingClientRect().height > 50).length;
// heads are text alone: a browser repeats no buttons on later pages
found.buttons = all("th button").filter(part => getComputedStyle(part).display !== "contents").length;
return found;
"""


@pytest.fixture(scope="module")
def found(page, tmp_path_factory):
    return measure(tmp_path_factory.mktemp("browser"), page.read_text(encoding="utf-8"), SCRIPT)


def test_nothing_runs_over_the_side_or_is_cut_on_paper(found):
    for width in (390, 820, 1440):
        at = found[str(width)]
        assert at["window"] == width and at["page"] <= width and at["over"] == []
        assert at["boxes"] > 0 and at["cut"] > 0  # wide and long tables scroll by themselves
    at = found["paper"]
    assert at["window"] == 1032 and at["page"] <= 1032 and at["over"] == []
    assert at["boxes"] == at["cut"] == 0
    # heads are repeated, and all cards and pictures shown
    assert found["still"] == found["buttons"] == 0 and found["cards"] == 5 + 6
    before, during, after = found["open"]
    assert before == after < during == found["all"]


def test_headers_sort_up_and_down(found):
    assert found["sorted"] == ["b a9 a10", "a9 b a10", "a9 a10 b", "b a10 a9", "a10 b a9"]
    assert found["order"] == [None, None, "ascending"]


def test_the_first_screen_holds_all_answers(found):
    assert 500 < found["front"] <= 800 - 90  # a title and a line stand above


def test_the_policy_lets_the_page_s_own_script_run_and_no_other(page, tmp_path):
    foreign = "<script>document.body.dataset.foreign = 'ran';</script></body>"
    (tmp_path / "added.html").write_text(
        page.read_text(encoding="utf-8").replace("</body>", foreign), encoding="utf-8"
    )
    after = dom(tmp_path, tmp_path / "added.html")
    assert "data-foreign" not in after and re.search(r"<th[^>]*><button", after)
