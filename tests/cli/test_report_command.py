"""``adaptmg report``: a page of a store, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from adaptmg.cli import app
from adaptmg.study import Study


@pytest.fixture
def command(capsys, monkeypatch, tmp_path):
    """Run ``adaptmg report`` in this process, in a folder of its own: exit code, standard error."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as end:
            app(["report", *arguments], prog_name="adaptmg")
        return end.value.code or 0, capsys.readouterr().err

    return run


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
    assert "<svg" in page and "three &lt;b&gt;" in page and "<b>&</b>" not in page
    assert pd.read_csv("first.csv")["m"].dropna().tolist() == [0.5, 1.0]
    assert command("s.sqlite", "--result", "w", "--to", "other.html")[0] == 0
    assert Path("other.html").read_text(encoding="utf-8").count("<svg") < page.count("<svg")


def test_what_cannot_be_shown_is_told(command):
    stored()
    assert "no such store" in command("none.sqlite")[1]
    code, err = command("s.sqlite", "--result", "cycles")
    assert code != 0 and "cycles" in err and "Traceback" not in err
    stored("second")
    assert "give --study, one of first, second" in command("s.sqlite")[1]
    assert "did you mean 'first'" in command("s.sqlite", "--study", "frist")[1]
