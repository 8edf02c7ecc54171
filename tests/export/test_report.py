"""Reports: one page that needs nothing else, answers first, folds, escapes, and is sound HTML."""

import base64
import hashlib
import re

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from pages import Page

import adaptmg as am
from adaptmg.export.report import DENSE, LONGEST, columns_of, one_line, worded

#: names that end an attribute, open a tag, or are not allowed in XML or UTF-8 at all
NASTY = (
    "a<b>&\"'",
    "]]>",
    "<!--",
    "&#0;",
    "line\nbreak\ttab",
    "\x00\x01\x1b[31m\x7f\x9f",
    "\udcff\ud800",
    "\ufffe\uffff",
    "\U0001fffe",
    "\u00b5 \u4e2d \U0001f600",
    " ",
)
FRAME = pd.DataFrame({"n<": [1], "t": ["<script>alert(1)</script>"]})


def drawing(count: int = 2, label: str = ""):
    """A figure with a line of ``count`` points, markers and a clip path."""
    figure, ax = plt.subplots(figsize=(4, 3))
    ax.plot(np.arange(count), np.random.default_rng(0).random(count), marker="o", label=label)
    ax.set_xlabel(label)
    return figure


def made(tmp_path, fill, **options) -> tuple[Page, str]:
    """The page that ``fill`` makes, parsed, and its text; figures of other tests are closed
    before."""
    plt.close("all")
    report = am.export.Report("Smoothing & <co>", "One.\n\nTwo <b>.", **options)
    fill(report)
    text = report.write(tmp_path / "report.html").read_text(encoding="utf-8")
    return Page(text), text


def example(report: am.export.Report) -> None:
    """All kinds of parts."""
    report.card("Best <sweeps>", "Two & no more.", to="first", table=FRAME, units={"n<": "m<"})
    report.card("A picture", to="nowhere", figure=drawing())
    report.card("Absent", "Run <it>.")
    report.section(
        "Sweeps <1>", "Text & more {{ 7 * 7 }}{% x %}.", summary="In short <i>.", key="first"
    )
    report.table(FRAME, "Table 1 & so on", "note <i>", units={"t": "µs"}, csv='a "b".csv')
    report.figure(drawing(label="<b> & x"), 'A "picture" <x>')
    report.section("Second")
    report.figure(drawing(), "again")
    report.made(random_seeds="1 < 2")


def test_a_report_is_one_sound_page_that_needs_nothing_else(tmp_path):
    page, text = made(tmp_path, example, terms="A unit.")
    assert [tmp_path / "report.html"] == list(tmp_path.iterdir())
    assert len(page.drawings) == len(page.all("img")) == 3
    assert (
        not page.all("link")
        and len(page.all("style")) == 1
        and not re.search(r"@import|https?://", text)
    )
    assert {"contents", "first", "section-2", "made"} <= {
        a["id"] for _, a in page.tags if "id" in a
    }
    assert (
        len(page.all("table")) == 2 and len(page.all("table", "sort")) == 1
    )  # that of a card is not sorted
    links = [a["href"] for a in page.all("a")]
    assert {"#first", "#section-2", "#made", "a%20%22b%22.csv"} <= set(
        links
    ) and "#nowhere" not in links
    assert not plt.get_fignums()


def test_a_report_escapes_everything(tmp_path):
    page, text = made(tmp_path, example)
    for raw in (
        "<co>",
        "<b>",
        "<i>",
        "<x>",
        "Sweeps <1>",
        "n<<",
        "alert(1)</script>",
        "<it>",
        "<sweeps>",
    ):
        assert raw not in text
    assert len(page.all("script")) == 1 and "<script>alert(1)</script>" in page.text("td")
    for shown in (
        "Smoothing & <co>",
        "Two <b>.",
        'A "picture" <x>',
        "Run <it>.",
        "[m<]",
        "1 < 2",
        "Text & more {{ 7 * 7 }}{% x %}.",
    ):
        assert shown in page.text(), shown
    assert "<b> & x" in page.drawings[1]
    origin = page.text("dt", "dd")
    assert all(
        word in origin
        for word in ("Versions", "numpy", "Machine", "cores", "Written", "Random seeds")
    )
    # only the script of the page may run
    policy = next(
        a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"
    )
    script = re.search(r"<script>(.*?)</script>", text, re.DOTALL)[1]
    assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in policy
    assert "default-src 'none'" in policy


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.parametrize("name", (*NASTY, "r\u202ex"), ids=ascii)
def test_any_text_gives_a_sound_report(tmp_path, name):
    report = am.export.Report(f"t{name}", name)
    # pandas' own texts hold nothing else than UTF-8 where pyarrow is installed
    frame = pd.DataFrame([[name]], columns=pd.Index([f"c{name}"], dtype=object), dtype=object)
    report.card(f"k{name}", name, table=frame)
    report.section(f"s{name}", name, summary=name)
    report.table(frame, f"t{name}", name, units={f"c{name}": f"u{name}"})
    report.figure(plt.figure(figsize=(0.5, 0.5)), f"f{name}")
    figure = plt.figure(figsize=(1, 1))
    # letters that UTF-8 does not have are drawn by no format of matplotlib
    figure.text(0.1, 0.5, name.encode("utf-8", "ignore").decode(), parse_math=False)
    report.figure(figure, f"g{name}")
    report.made(said=f"m{name}")
    text = report.write(tmp_path / "r.html").read_text(encoding="utf-8")
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\ufffe\uffff]", text)
    page = Page(text)
    assert page.text("title") == one_line(f"t{name}")
    if name.strip():
        assert one_line(name) in page.text("th")


def test_first_tables_of_sections_stand_open(tmp_path):
    def fill(report):
        report.card("front", table=FRAME)
        for k in range(3):
            report.section(f"s{k}")
            for name in "abc":
                report.table(FRAME, f"table {k}", open=name == "c")

    page, _ = made(tmp_path, fill)
    assert ["open" in a for a in page.all("details", "table")] == [True, False, True] * 3


def test_numbers_are_marked_and_long_tables_cut(tmp_path):
    page, _ = made(tmp_path, lambda r: r.table(pd.DataFrame({"a": ["x"], "b": [1.5]}), "t"))
    assert [a.get("scope") for a in page.all("th")] == ["col", "col", "row"]
    assert [a.get("class") for a in page.all("td")] == ["n"] and page.text("td") == "1.5"
    page, _ = made(tmp_path, lambda r: r.table(pd.DataFrame({"a": range(LONGEST + 7)}), "t"))
    assert len(page.all("tr")) == LONGEST + 1 and f"of {LONGEST + 7} rows" in page.text("p")
    assert page.all("div", "tall")


def test_all_paragraphs_but_the_first_fold(tmp_path):
    page, text = made(tmp_path, lambda r: r.section("s", "One <b>.\n\nTwo.\n\nThree."))
    assert len(page.all("details", "more")) == 1 and "One <b>." in page.text("p")
    assert text.index("More") < text.index("Two.") < text.index("Three.")


def test_drawings_stay_letters_and_dense_ones_become_pictures(tmp_path):
    def fill(report):
        report.figure(drawing(label="frictionvalue"), "few")
        report.figure(drawing(5000), "many")

    page, text = made(tmp_path, fill)
    assert len(page.drawings) == 1 and "frictionvalue" in page.drawings[0]
    data = page.all("img")[1]["src"].removeprefix("data:image/png;base64,")
    assert base64.b64decode(data).startswith(b"\x89PNG") and len(text) < 4 * DENSE


def test_bad_arguments_are_refused(tmp_path):
    page = am.export.Report("x")
    page.section("s", key="a")
    for call, error, message in (
        (lambda: page.table([[1]], "caption"), TypeError, "DataFrame"),
        (lambda: page.table(FRAME, ""), ValueError, "caption"),
        (lambda: page.table(FRAME, "c", units={"b": "s"}), ValueError, "units"),
        (lambda: page.figure("file.png", "caption"), TypeError, "Figure"),
        (
            lambda: page.card("t", table=FRAME, figure=plt.figure()),
            ValueError,
            "a table or a figure",
        ),
        (lambda: page.section("s", key="a b"), ValueError, "key must begin"),
        (lambda: page.section("s", key="a"), ValueError, "another section"),
        (lambda: page.section("s", key="made"), ValueError, "another section"),
        (lambda: am.export.Report(""), ValueError, "title"),
        (lambda: page.write(tmp_path / "nowhere" / "x.html"), FileNotFoundError, "nowhere"),
    ):
        with pytest.raises(error, match=message):
            call()
    plt.close("all")


@pytest.mark.parametrize(
    ("values", "spec", "shown"),
    [
        ([0.0534, 0.015004, np.nan], "", ["0.0534", "0.015", "-"]),
        ([1, 2, 30], "", ["1", "2", "30"]),
        (["1.5", "b"], "", ["1.5", "b"]),
        ([1.26, np.inf], ".1f", ["1.3", "inf"]),
        (pd.array([1.26, None], "Float64"), ".2g", ["1.3", "-"]),
    ],
)
def test_numbers_have_their_format(values, spec, shown):
    (column,) = columns_of(pd.DataFrame({"x": values}), None, {"x": spec} if spec else None)
    assert column.texts == shown


def test_identifiers_become_words_and_their_unit():
    assert worded("total_s") == ("total", "s") and worded("mesh_ratio") == ("mesh ratio", "")
    assert worded("total_s", "ms") == ("total s", "ms")
    assert worded("u_n") == ("u_n", "") and worded("a b") == ("a b", "")
