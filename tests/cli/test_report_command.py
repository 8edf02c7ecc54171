"""``adaptmg report``: a page of a store, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from adaptmg.study import Study
from adaptmg.study.record import Record
from adaptmg.study.store import Store


@pytest.fixture
def command(command):
    """``adaptmg report``: exit code, standard error."""
    return lambda *arguments: command("report", *arguments)[::2]


def stored(name: str = "first") -> None:
    """Three runs, one of which failed, with texts that a page must escape."""
    def run(n, law):
        if n == 3:
            raise ValueError("three <b>&</b> more")
        return {"m": n * 0.5, "w": 2.0 * n}

    Study(run, {"n": [1, 2, 3], "law": ["<i>"]}, "s.sqlite", name=name).run(progress=False)


def test_a_page_and_its_table_stand_beside_the_store(command):
    stored()
    code, err = command("s.sqlite")
    assert code == 0 and "wrote first.html and first.csv" in err
    page = Path("first.html").read_text(encoding="utf-8")
    assert "data:image/svg+xml" in page and "three &lt;b&gt;" in page and "<b>&</b>" not in page
    assert pd.read_csv("first.csv")["m"].dropna().tolist() == [0.5, 1.0]
    assert command("s.sqlite", "--result", "w", "--to", "other.html")[0] == 0
    assert Path("other.html").read_text(encoding="utf-8").count("<img") < page.count("<img")


def test_a_study_whose_name_is_not_that_of_a_file_needs_a_file(command):
    stored("a/b")
    code, err = command("s.sqlite")
    assert code == 2 and err.endswith("--to must be given, as the name of the study cannot be that of a file: 'a/b'\n")
    assert command("s.sqlite", "--to", "ab.html")[0] == 0


def test_a_page_says_what_all_runs_share_units_and_when_they_were_made(command):
    store = Store("s.sqlite")
    same = {"case.case": "greco_bar", "h.sizes": (0.01, 5e-3), "measure.columns": ("max_pressure",)}
    store.put_all("study", [Record(parameters=same | {"case.friction": k / 2}, status="done", machine="node7",
                                   results={"max_pressure": 1e6 * k, "text": "\udcff"}, commit="c" * 40,
                                   finished=f"2026-01-0{k}T10:00:00") for k in range(1, 4)])
    assert command("s.sqlite")[0] == 0
    page = Path("study.html").read_text(encoding="utf-8")
    for words in ("In all runs case.case = greco_bar; h.sizes = [0.01, 0.005].", "[Pa]", "node7", "cccccccccccc<",
                  "2026-01-01T10:00 to 2026-01-03T10:00 UTC", r"\udcff"):
        assert words in page, words
    assert "measure.columns" not in page
    code, err = command("s.sqlite", "--to", "study.csv")
    assert code == 2 and "must be an HTML file" in err


def test_what_cannot_be_shown_is_told(command):
    stored()
    assert "no such store" in command("none.sqlite")[1]
    code, err = command("s.sqlite", "--result", "cycles")
    assert code != 0 and "cycles" in err and "Traceback" not in err
    stored("second")
    assert "give --study, one of first, second" in command("s.sqlite")[1]
    assert "did you mean 'first'" in command("s.sqlite", "--study", "frist")[1]
