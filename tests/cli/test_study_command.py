"""``adaptmg study`` and ``adaptmg runs``: files that are run, and files that are refused with line and suggestion."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

import adaptmg as am
from adaptmg.study import Study
from adaptmg.study.store import Store

EXAMPLES = sorted((Path(__file__).parents[2] / "studies").glob("*.toml"))
GOOD = """
name = "bar"
store = "bar.sqlite"

[case]
case = "greco_bar"
friction = 0.3
top_pressure = 5e7

[hierarchy]
divisions = [2, 4]

[solver]
method = "full-multigrid"

[measure]
columns = ["outcome", "cycles", "nodes", "stick", "force_y", "max_pressure"]

[vary]
"case.friction" = [0.2, 1.0]
"hierarchy.divisions" = [[2, 4], [4, 8]]
"""


def written(text: str = GOOD) -> str:
    Path("study.toml").write_text(text, encoding="utf-8")
    return "study.toml"


def test_a_file_is_run_once_and_gives_what_a_script_gives(command):
    code, out, err = command("study", written())
    assert code == 0 and "4 done" in out and "[4/4]" in err and "Traceback" not in err
    code, out, err = command("study", "study.toml", "--json")
    said = json.loads(out)
    assert code == 0 and "[" not in err and said["done"] == 4
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(1.0), top_pressure=5e7), divisions=(4, 8))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    row = said["rows"][3]
    assert (row["case.friction"], row["hierarchy.divisions"]) == (1.0, [4, 8])
    assert (row["cycles"], row["nodes"], row["outcome"]) == (result.cycles, 81, "CONVERGED")
    assert row["max_pressure"] == result.contact.pressure.max() and row["machine"]


def test_a_dry_run_says_what_there_is_and_leaves_nothing(command, tmp_path):
    code, out, _ = command("study", written(), "--dry-run")
    assert code == 0 and "4 missing" in out and [p.name for p in tmp_path.iterdir()] == ["study.toml"]
    assert json.loads(command("study", "study.toml", "--dry-run", "--json")[1])["missing"] == 4
    lines = [line.split() for line in out.splitlines()]
    assert lines[0] == ["case.friction", "hierarchy.divisions", "status"] and lines[2] == ["0.2", "2,", "4", "missing"]
    many = GOOD.replace("[0.2, 1.0]", str([k / 100 for k in range(50)]))
    assert "... 80 more" in command("study", written(many), "--dry-run")[1]


def test_workers_give_the_same_table(command):
    text = written()
    command("study", text, "--store", "one.sqlite")
    code, *_ = command("study", text, "--store", "two.sqlite", "--workers", "2")
    one, two = (Store(f"{name}.sqlite").get("bar") for name in ("one", "two"))
    assert code == 0 and {k: r.results for k, r in one.items()} == {k: r.results for k, r in two.items()}


def test_a_run_that_fails_ends_with_code_1_and_is_tried_again_when_asked(command):
    text = GOOD.replace("[[2, 4], [4, 8]]", "[[2, 4], [1]]")
    code, out, err = command("study", written(text))
    assert code == 1 and "2 failed" in out
    assert err.splitlines()[-1] == "adaptmg: 2 of 4 runs failed: --retry-failed runs them again"
    before = {key: record.finished for key, record in Store("bar.sqlite").get("bar").items()}
    command("study", "study.toml")
    assert {key: record.finished for key, record in Store("bar.sqlite").get("bar").items()} == before
    command("study", "study.toml", "--retry-failed")
    after = Store("bar.sqlite").get("bar")
    assert sum(after[key].finished != before[key] for key in before) == 2


def test_load_paths_samples_and_kept_results(command):
    text = GOOD.replace("[solver]", "[load_path]\nleft = [0.5, 1.0]\n\n[solver]")
    text = text.replace('"stick"', '"steps"').replace("[vary]", "keep = true\n\n[design]\nkind = \"sobol\"\nruns = 2\n"
                                                                  "log = [\"case.friction\"]\n\n[vary]")
    text = text.replace('"hierarchy.divisions" = [[2, 4], [4, 8]]\n', "")
    code, out, _ = command("study", written(text), "--json")
    rows = json.loads(out)["rows"]
    assert code == 0 and [row["steps"] for row in rows] == [2, 2]
    assert all(0.2 <= row["case.friction"] <= 1.0 for row in rows)
    assert am.Result.load(Path("bar.sqlite.files") / rows[0]["result"]).dim == 2


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_the_examples_can_be_run(command, file):
    code, out, err = command("study", str(file), "--dry-run")
    assert code == 0 and "missing" in out, err


def test_runs_are_listed_filtered_written_and_taken_in(command):
    def run(n, law):
        if n == 3:
            raise ValueError("three & more")
        return {"m": n / 2, "what": "a_b"}

    Study(run, {"n": [1, 2, 3], "law": ["a", "b"]}, "s.sqlite", name="first", fixed={}).run(progress=False)
    code, out, _ = command("runs", "s.sqlite", "--limit", "2")
    assert code == 0 and "... 4 more" in out
    rows = json.loads(command("runs", "s.sqlite", "--status", "done", "--where", "law=b", "--details", "--json")[1])
    assert [(row["n"], row["m"], row["tries"]) for row in rows] == [(1, 0.5, 1), (2, 1.0, 1)]
    assert command("runs", "s.sqlite", "--to", "t.csv")[0] == command("runs", "s.sqlite", "--to", "t.tex")[0] == 0
    assert pd.read_csv("t.csv")["m"].dropna().tolist() == [0.5, 0.5, 1.0, 1.0]
    tex = Path("t.tex").read_text(encoding="utf-8")
    assert r"a\_b" in tex and r"three \& more" in tex and tex.count(r"\\") == 7
    for n, store in ((1, "s.sqlite"), (5, "other.sqlite")):
        Study(lambda n: {"m": n}, {"n": [n]}, store, name="second").run(progress=False)
    code, out, err = command("runs", "s.sqlite", "--study", "second", "--take-in", "other.sqlite")
    assert code == 0 and "1 runs taken in" in err and "2 runs" in out
