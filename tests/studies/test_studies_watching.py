"""What one sees while studies run at once: on a terminal and elsewhere."""

from __future__ import annotations

import io
import re

from rich.console import Console
from study_scripts import load

from adaptmg.study.progress import Watch

watching = load("watching")


def seen(terminal: bool, every: float = 0.0) -> str:
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=70, color_system=None)
    with watching.Watching(2, every, console) as shown:
        first, second = (Watch(name, 3, 0, lambda: 1) for name in ("bars.one_grid", "joints.several_grids"))
        for watch in (first, second, first, first):
            watch.done += 1
            shown.run_ended(watch)
        with shown.printing():
            print("the table", file=out)
        shown.study_ended("bars", 2.3)
        shown.study_ended("joints", 3.0)
    return out.getvalue()


def test_elsewhere_there_are_lines():
    lines = seen(False).splitlines()
    assert [re.sub(r"\d:\d\d min", "m:ss min", line) for line in lines] == [
        "m:ss min, 0 of 2 studies done, runs: 1; bars.one_grid 1/3",
        "m:ss min, 0 of 2 studies done, runs: 2; joints.several_grids 1/3; bars.one_grid 1/3",
        "m:ss min, 0 of 2 studies done, runs: 3; bars.one_grid 2/3; joints.several_grids 1/3",
        "m:ss min, 0 of 2 studies done, runs: 4; joints.several_grids 1/3",
        "the table", "[1/2] bars: done after 2 s",
        "m:ss min, 1 of 2 studies done, runs: 4; joints.several_grids 1/3", "[2/2] joints: done after 3 s"]


def test_elsewhere_lines_are_not_many():
    assert seen(False, 1e9).splitlines() == ["the table", "[1/2] bars: done after 2 s", "[2/2] joints: done after 3 s"]


def test_on_a_terminal_a_line_is_cut_and_away_while_tables_are_printed():
    text = seen(True)
    assert "studies done" in text and text.count("done after") == 2
    at = text.index("the table")
    assert text[:at].rpartition("\x1b[?25")[2].startswith("h")  # the cursor is back: nothing is drawn any more
    plain = re.sub(r"\x1b\[[^a-zA-Z]*[a-zA-Z]", "", text)
    assert max(len(line.rpartition("\r")[2]) for line in plain.splitlines()) <= 70
