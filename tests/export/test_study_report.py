"""The report of a study's table: counted, drawn against what varied, failures apart."""

import numpy as np
import pandas as pd
import pytest
from pages import Page

import adaptmg as am
from adaptmg.export.report import Axis, axes_of_study, curves


def table(repeats: int = 2) -> pd.DataFrame:
    """A study of sweeps and friction with repeats, one run failed."""
    rows = [
        {
            "sweeps": s,
            "friction": f,
            "seed": k,
            "cycles": 20 // s + k,
            "work_units": 3.0 * s * f,
            "total_s": 0.5,
            "method": "V",
            "status": "done",
            "seconds": 0.1,
            "error": "",
        }
        for s in (1, 2, 3)
        for f in (0.1, 1.0)
        for k in range(repeats)
    ]
    rows[3].update(status="failed", error="ValueError: <b>no</b> " + "x" * 5000, cycles=np.nan)
    frame = pd.DataFrame(rows)
    frame.attrs = {"study": "smoothing <1>", "fixed": {"rtol": 1e-8}}
    return frame


def written(tmp_path, frame, **options) -> Page:
    path = am.export.study_report(
        frame, tmp_path / "r.html", **({"parameters": ["sweeps", "friction", "seed"]} | options)
    )
    return Page(path.read_text(encoding="utf-8"))


def test_it_counts_draws_and_lists(tmp_path):
    page = written(
        tmp_path, table(), csv="runs.csv", summary="What <b> came out.", made={"commit": "abc"}
    )
    assert "smoothing <1>" in page.text(
        "h1"
    ) and "12 runs, 11 done, 1 failed. What <b> came out." in page.text("p")
    drawn = [a["alt"] for a in page.all("img")]
    assert [name.split(",")[0] for name in drawn] == [
        "cycles against sweeps",
        "work units against sweeps",
    ]
    assert len(page.all("details", "table")) == 2 and "runs.csv" in [
        a["href"] for a in page.all("a")
    ]
    assert "rtol = 1e-08" in page.text("dd") and "abc" in page.text("dd")
    errors = next(text for text in page.text("td").split("ValueError")[1:])
    assert "<b>no</b>" in errors and len(errors) < 600
    page = written(tmp_path, table(), results=["work_units"], units={"work_units": "WU"})
    assert len(page.drawings) == 1 and "work units [WU]" in page.drawings[0]


def test_a_study_too_long_to_be_shown_says_what_came_out_of_all(tmp_path):
    frame = table(2000).assign(method="word " * 200)
    page = written(tmp_path, frame, csv="runs.csv", parameters=["sweeps", "friction"])
    assert "12,000 runs, 11,999 done" in page.text("p") and "12,000 rows" in page.text("span")
    assert "All rows as CSV" in page.text("a") and len(page.all("details", "table")) == 2
    assert "word " * 30 in page.text("p", "td") and "word " * 70 not in page.text("p", "td")
    drawn = [a["alt"] for a in page.all("img")]
    assert all("from the least to the largest" in label for label in drawn) and drawn


@pytest.mark.parametrize(
    "frame",
    [
        table().head(0),
        table().head(1),
        table().assign(status="failed"),
        table().assign(status="missing", cycles=np.nan, work_units=None),
        table().drop(columns=["status", "error"]),
        table().assign(cycles=np.inf, work_units=np.nan),
    ],
    ids=["no rows", "one row", "all failed", "none run", "bare", "not finite"],
)
def test_any_state_of_a_study_gives_a_page(tmp_path, frame):
    assert written(tmp_path, frame).all("table")


@pytest.mark.parametrize(
    "values",
    [
        ["x", "y", "z"],
        [None, 1, 2.5],
        [(1, 2), (3, 4), "V"],
        [True, False, True],
        [1, True, "1"],
        [f"n{k}" for k in range(90)],
        np.geomspace(1e-8, 1, 90),
        ["$x_", "_y", "\x00"],
    ],
    ids=["names", "none", "tuples", "bools", "mixed", "many names", "wide ranges", "odd names"],
)
def test_any_parameter_is_drawn(tmp_path, values):
    frame = pd.DataFrame({"$a_": values, "r": np.geomspace(1e9, 1, len(values))})
    assert written(tmp_path, frame, parameters=["$a_"]).all("img")


def test_the_axis_is_the_number_with_most_values():
    frame = table().assign(number=range(12))
    assert axes_of_study(frame, ["friction", "sweeps"]) == Axis("sweeps", "friction")
    assert axes_of_study(frame, ["method", "seed"]) == Axis("seed", "")
    assert axes_of_study(frame, ["sweeps", "number"]) == Axis(
        "sweeps", ""
    )  # a seed is in every run another
    assert axes_of_study(frame, ["number"]) == Axis("number", "")
    close = frame.assign(close=[1.0, 1.0000001, np.nan] * 4)
    assert axes_of_study(close, ["friction", "close"]) == Axis("close", "friction")
    frame["random"] = np.random.default_rng(0).random(len(frame))
    assert axes_of_study(frame, ["random", "number"]) == Axis("random", "", joined=False)
    # few runs: a line for each seed would be a point
    few = frame.head(6)
    assert axes_of_study(few, ["friction", "sweeps", "number"]) == Axis("friction", "sweeps")
    assert axes_of_study(few, ["random", "number"]) == Axis("random", "", joined=False)
    assert axes_of_study(frame, ["method"]) is None and axes_of_study(frame, []) is None


def test_lines_are_medians_and_bands_span_the_runs():
    frame = pd.DataFrame({"a": [1, 1, 1, 2, 2, 2], "r": [1.0, 2.0, 9.0, 4.0, 5.0, 6.0]})
    ax = curves(frame, Axis("a", ""), "r").axes[0]
    assert ax.lines[0].get_ydata().tolist() == [2.0, 5.0]
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert band.min() == 1.0 and band.max() == 9.0


def test_bad_arguments_are_refused(tmp_path):
    for frame, options, error, message in (
        ([], {"parameters": []}, TypeError, "DataFrame"),
        (table(), {"parameters": "sweeps"}, TypeError, "sequence of names"),
        (
            table(),
            {"parameters": ["sweps"]},
            ValueError,
            r"columns the table does not have: \['sweps'\]",
        ),
        (
            table(),
            {"results": ["method"]},
            ValueError,
            "'method' holds no numbers to draw, got 'V'",
        ),
    ):
        with pytest.raises(error, match=message):
            written(tmp_path, frame, **options)
    assert not list(tmp_path.iterdir())
