"""The studies run, check themselves and write their section; ``reproduce.py`` makes a page and the
recorded numbers.

``reproduce.py --quick`` runs each of them in CI, in a process of its own.
"""

import argparse
import ast
import dataclasses
import json
import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from pages import Page
from study_scripts import ROOT, STUDIES, load

import adaptmg as am

common, reproduce = load("common"), load("reproduce")
#: files in studies/ that are no study
OTHERS = {"common", "reproduce", "linear_rivals", "plain_newton", "pictures", "docs", "petsc"}
ALL = reproduce.STUDIES | reproduce.LARGE


def test_every_study_is_listed_with_its_question_and_is_short():
    scripts = {path.stem for path in STUDIES.glob("*.py")} - OTHERS
    assert scripts == set(ALL)
    for name in scripts:
        lines = (STUDIES / f"{name}.py").read_text().splitlines()
        statements = sum(
            isinstance(node, ast.stmt) for node in ast.walk(ast.parse("\n".join(lines)))
        )
        assert statements <= (60 if name.startswith("table") else 180)
        assert (
            reproduce.question(name).endswith("?")
            and f"    python studies/{name}.py [--quick | --full]" in lines[2]
        )
    described = subprocess.run(
        [sys.executable, str(STUDIES / "reproduce.py"), "--help"],
        text=True,
        capture_output=True,
        check=True,
    ).stdout
    assert all(f"  {name} " in described for name in ALL)


def made(folder, value=1.0):
    """Sections of two studies and none of the others."""
    for name, card in (("table_1_grids", "Table 1 on the first screen"), ("dovetail", "")):
        out = common.Output(name, folder)
        out.table(
            "one",
            pd.DataFrame({"n": [1, 2], "time": [0.5, value]}),
            f"caption of {name}",
            "a note",
            card=card,
            units={"time": "s"},
            formats={"time": ".2f"},
        )
        figure, ax = common.drawing()
        ax.plot([1, 2], label="a line")
        out.figure("picture", figure, "A picture.", card=card and "A picture on the first screen")
        out.number(f"time of {name}", f"{value:g} s")
        out.check("the value", value, high=2.0)
        out.close("Does it?\n\n    python studies/x.py\n\nIt may.")
    return out


def test_the_page_shows_what_studies_left_and_what_is_missing(tmp_path, capsys):
    assert not made(tmp_path).failed and made(tmp_path, 3.0).failed == [
        "the value: 3 (at most 2; NOT MET)"
    ]
    names = ["table_1_grids", "dovetail", "hertz"]
    path = reproduce.report(names, tmp_path, argparse.Namespace(quick=True), {"hertz"})
    page = Page(path.read_text(encoding="utf-8"))
    assert {"#table_1_grids", "#hertz", "table_1_grids/one.csv"} <= {
        a["href"] for a in page.all("a")
    }
    assert (
        len(page.all("div", "card")) == 2
        and len(page.all("img")) == 3
        and "3.00" in page.text("td")
    )
    assert (
        "This study failed" in page.text("p")
        and "quick run" in page.text("p")
        and "NOT MET" in page.text("p")
    )


def test_recorded_numbers_are_those_of_the_sections(tmp_path):
    made(tmp_path, 1.25)
    measured = tmp_path / "measured"
    readme = tmp_path / "README.md"
    head = "# x\n\n<!-- data/measured/readme.csv -->\n\n"
    readme.write_text(f"{head}| what | measured |\n|---|---|\n| old | 1 |\n\nend | of\n")
    reproduce.record(tmp_path, ALL, measured, readme)
    assert {file.name for file in measured.iterdir()} == {"one.csv", "readme.csv"}
    assert readme.read_text().splitlines()[6:] == [
        "| time of table_1_grids | 1.25 s |",
        "| time of dovetail | 1.25 s |",
        "",
        "end | of",
    ]
    _, rows = reproduce.read_measured(measured / "readme.csv")
    assert rows.to_numpy().tolist() == [
        [f"time of {name}", "1.25 s"] for name in ("table_1_grids", "dovetail")
    ]
    caption, note, run, *table = (measured / "one.csv").read_text().splitlines()
    assert (caption, note) == ("# caption of table_1_grids", "# a note")
    assert re.search(r"reproduce\.py, commit .*, \d{4}-\d\d-\d\d, .*\d processors$", run)
    assert table == ["n,time [s]", "1,0.50", "2,1.25"]


def test_the_readme_has_the_numbers_that_were_recorded():
    files = list((ROOT / "data" / "measured").glob("*.csv"))
    assert len(files) <= 7
    for file in files:
        comments, table = reproduce.read_measured(file)
        assert len(comments) >= 2 and 0 < len(table) <= 15, file
    text = reproduce.README.read_text(encoding="utf-8")
    shown = list(reproduce.TABLE.finditer(text))
    assert {found[1] for found in shown} == {"readme", "saved"}
    for found in shown:
        assert found[0] == reproduce.markdown(found[1])


def test_the_campaign_of_loops_sees_spoilt_meshes():
    loops = load("random_loops")
    for make in loops.MAKERS[1:]:
        assert isinstance(make(np.random.default_rng(3)), am.ContactProblem)
    mesh = am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 4)
    assert loops.mesh_faults(mesh, mesh, False) == []
    inside = mesh.points.copy()
    inside[0] = [0.1, 0.1]
    for words, change in (
        ("sizes", {"points": inside}),
        ("names of", {"boundaries": ("a", *mesh.boundaries[1:])}),
        ("no edge of", {"elements": mesh.elements[1:], "element_body": None}),
    ):
        faults = loops.mesh_faults(dataclasses.replace(mesh, **change), mesh, False)
        assert any(words in fault for fault in faults), words


@pytest.mark.slow
def test_table_1_is_made_for_another_problem_and_other_numbers_of_grids(
    tmp_path, monkeypatch, capsys
):
    """The recipe of the how-to "Short answers"; and what a study writes and prints."""
    text = (STUDIES / "table_1_grids.py").read_text(encoding="utf-8")
    for before, after in (
        ('PROBLEM = "GRECO bar"', 'PROBLEM = "curved obstacle"'),
        ("COUNTS = [2, 3, 4]", "COUNTS = [3]"),
        ("TARGET = 1e-6", "TARGET = 1e-2"),
    ):
        assert before in text
        text = text.replace(before, after)
    (tmp_path / "table_1_curved.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    table = load("table_1_curved")
    out = table.Output("table_1_curved", tmp_path, quick=True)
    table.study(out)
    out.close(table.__doc__)
    first = pd.read_csv(out.folder / "table_1.csv", dtype=str).set_index("method")
    assert list(first) == ["1 grid", "3 grids"]
    assert first.loc["one grid", "1 grid"].startswith("1.0 / 1.0 (")
    assert first.loc["the paper", "3 grids"].startswith("21.7")
    assert first["3 grids"].notna().sum() == 6
    section = json.loads((out.folder / "section.json").read_text())
    assert section["title"].endswith("?")
    assert {item["kind"] for item in section["items"]} >= {"table", "figure", "check"}
    printed = capsys.readouterr().out
    for item in section["items"]:
        if item["kind"] == "table":
            frame = pd.read_csv(out.folder / f"{item['name']}.csv")
            assert len(frame) and set(item["units"]) | set(item["formats"]) <= set(frame)
            assert f"\n{item['caption']}\n" in printed
