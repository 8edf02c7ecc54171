"""``adaptmg study``: files that are run, options, exit codes, JSON, what is measured, what a user can read of it."""

import json
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import adaptmg as am
from adaptmg.cli import build, study_file
from adaptmg.cli.build import PURPOSE, case_keys, grids, sections
from adaptmg.cli.case_run import MEASURES, case_run
from adaptmg.cli.study_file import checked, read
from adaptmg.study import Study
from adaptmg.study.store import Store

EXAMPLES = sorted((Path(__file__).parents[2] / "studies").glob("*.toml"))
SMALL = """
[case]
case = "greco_bar"
[hierarchy]
divisions = [2, 4]
[measure]
columns = ["cycles"]
[vary]
case.friction = [0.2, 1.0]
"""
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


def test_options_reach_the_study(command, monkeypatch):
    given, run = {}, Study.run
    monkeypatch.setattr(Study, "run", lambda self, **options: given.update(options) or run(self, progress=False))
    text = written(SMALL.replace("[vary]", "[run]\nlimit_s = 9\ncost = \"cycles\"\n[vary]"))
    assert command("study", text, "--workers", "2", "--rerun", "--retry-failed", "--store", "two.sqlite")[0] == 0
    assert given == {"progress": None, "workers": 2, "scheduler": None, "rerun": True, "retry_failed": True,
                     "limit_s": 9.0, "cost": "cycles"} and Path("two.sqlite").exists()


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


def test_runs_are_listed_filtered_and_written(command):
    def run(n, law):
        if n == 3:
            raise ValueError("three & more")
        return {"m": n / 2, "what": "a_b"}

    Study(run, {"n": [1, 2, 3], "law": ["a", "b"]}, "s.sqlite", name="first", fixed={}).run(progress=False)
    code, out, _ = command("runs", "s.sqlite", "--limit", "2")
    assert code == 0 and "... 4 more" in out
    rows = json.loads(command("runs", "s.sqlite", "--status", "done", "--where", "law=b", "--details", "--json")[1])
    assert [(row["n"], row["m"], row["tries"]) for row in rows] == [(1, 0.5, 1), (2, 1.0, 1)]
    assert command("runs", "s.sqlite", "--to", "t.csv")[0] == 0
    assert pd.read_csv("t.csv")["m"].dropna().tolist() == [0.5, 0.5, 1.0, 1.0]
    Study(lambda n: {"m": n}, {"n": [1, 5]}, "s.sqlite", name="second").run(progress=False)
    code, out, _ = command("runs", "s.sqlite", "--study", "second")
    assert code == 0 and "2 runs" in out


def test_a_dry_run_says_what_there_is_and_leaves_nothing(command, tmp_path):
    code, out, _ = command("study", written(), "--dry-run")
    assert code == 0 and "4 missing" in out and [p.name for p in tmp_path.iterdir()] == ["study.toml"]
    assert out.split()[:3] == ["case.friction", "hierarchy.divisions", "status"]
    assert json.loads(command("study", "study.toml", "--dry-run", "--json")[1])["missing"] == 4


def test_keys_measures_and_cases_are_explained(command):
    code, text, _ = command("study", "--keys")
    assert code == 0 and set(PURPOSE) == set(sections()) and case_keys("dovetail")["friction"].default == "0.2"
    for section, known in sections().items():
        assert f"[{section}]" in text and all(f"\n  {name} " in text for name in known)
    assert all(f"\n  {name} " in text and meaning for name, (_, meaning, _) in MEASURES.items())
    facts = json.loads(command("study", "--keys", "--json")[1])
    assert facts["sections"]["hierarchy"]["sizes"]["values"] == "sequence of float or mapping"
    assert facts["sections"]["solver"]["rtol"]["default"] == "1e-08"
    assert facts["sections"]["solver"]["pre"]["meaning"].startswith("Smoothing sweeps before")
    assert facts["measures"]["max_pressure"] == {"meaning": "largest contact pressure", "unit": "Pa"}
    assert tomllib.loads(json.loads(command("study", "--template", "incline", "--json")[1])["template"])["vary"]
    text = command("cases", "cattaneo")[1]
    assert re.search(r"tangential\s+Q on the cylinder in \+x, N/m.*Default: 15000", text, re.DOTALL)
    assert "Young's modulus, Pa" in text and "lower.bottom, upper.top (names for" in text
    assert "did you mean 'dovetail'" in command("cases", "dovetial")[2]
    facts = {name: json.loads(command("cases", name, "--json")[1])["arguments"] for name in am.cases.names()}
    assert all(item["meaning"] for known in facts.values() for item in known.values())
    bolted = facts["bolted_junction"]
    assert bolted["bolt"]["values"] == "ring | traction | solid" and "law" not in bolted


def test_quiet_says_nothing_but_errors(command):
    assert command("study", written(SMALL), "--quiet") == (0, "", "")
    assert Path("results/study.sqlite").exists()
    code, out, err = command("study", written(SMALL.replace("[0.2, 1.0]", "[-1]")), "-q")
    assert (code, out) == (2, "") and err.count("\n") == 1


def test_failures_are_json_too(command):
    assert "--template" in json.loads(command("study", "--json")[1])["error"]
    code, out, err = command("study", "none.toml", "--json")
    assert code == 2 and "No such file" in json.loads(out)["error"] and err.startswith("adaptmg: ")
    for arguments in (("solve", "nothing"), ("adapt", "nothing"), ("cases", "nothing")):
        assert "there is no case 'nothing'" in json.loads(command(*arguments, "--json")[1])["error"]


def test_warnings_are_lines(command):
    code, _, err = command("solve", "leaning_strut", "--sizes", "20e-3,10e-3", "--contact-ratio", "2",
                           "--friction", "0.9")
    assert code == 0 and re.search(r"^adaptmg: warning: friction 0.9 exceeds", err, re.MULTILINE)
    assert "RuntimeWarning" not in err and ".py" not in err


def test_a_limit_without_workers_is_refused(command):
    code, _, err = command("study", written(SMALL.replace("[vary]", "[run]\nlimit_s = 9\n[vary]")))
    assert code == 2 and "limit_s and memory_limit need workers" in err
    assert "not both" in command("study", written(SMALL), "--workers", "2", "--scheduler", "tcp://localhost:1")[2]


def test_ctrl_c_says_how_to_go_on_and_the_same_command_does(command):
    written(SMALL.replace("[2, 4]", "[16, 32, 64]").replace("[0.2, 1.0]", str([k / 100 for k in range(1, 101)])))
    # in a shell's background the signal comes ignored
    code = ("import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nfrom adaptmg.cli import main\n"
            "main()")
    process = subprocess.Popen([sys.executable, "-c", code, "study", "study.toml"], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)
    while "[2/100]" not in (line := process.stderr.readline()):
        assert line
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130 and out == ""
    assert err.splitlines()[-1] == "adaptmg: interrupted: finished runs are stored, the same command goes on"
    done = json.loads(command("study", "study.toml", "--dry-run", "--json")[1])
    assert 2 <= done["done"] < 100 and done["missing"] == 100 - done["done"] and done["stale"] == 0


def test_everything_that_can_be_measured():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(1.0)), divisions=(4, 8))
    result = am.solve(grids)
    found = case_run(**{"case.case": "greco_bar", "case.friction": 1.0, "hierarchy.divisions": (4, 8),
                        "measure.columns": tuple(MEASURES), "measure.forces_on": ("bottom", "right"),
                        "measure.points.A": (0.0, 0.0), "measure.points.B": (0.04, 0.04)})
    contact, force = result.contact, result.resultant("right").force
    closed = contact.state != am.OPEN
    wanted = {"nodes": 81, "levels": 2, "steps": 1, "contact_nodes": 9, "max_gap": contact.gap.max(),
              "max_slip": abs(contact.slip[closed]).max(),
              "contact_area": contact.weights[closed].sum(), "max_traction": abs(contact.traction).max(),
              "max_von_mises": result.von_mises().max(), "energy_error": result.certificate().energy_error,
              "violation": result.certificate().worst.relative, "force_x(right)": force[0], "force_y(right)": force[1],
              "max_displacement": np.linalg.norm(result.displacement, axis=1).max(),
              "force_y": result.resultant("bottom").force[1], "force_x(bottom)": result.resultant("bottom").force[0],
              "A.x": result.probe([(0.0, 0.0)])[0, 0], "B.y": result.probe([(0.04, 0.04)])[0, 1]}
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12, abs=1e-30)
    assert (found["outcome"], found["force_z"], found["estimate"]) == ("CONVERGED", None, None)
    assert found["open"] + found["slip"] + found["stick"] == 9 and found["open"] == (~closed).sum() > 0
    assert set(found) == {*MEASURES, *(f"force_{c}({b})" for b in ("bottom", "right") for c in "xy"),
                          *(f"{p}.{c}" for p in "AB" for c in "xy")}


def test_cycles_and_work_are_those_of_all_load_steps_and_all_meshes():
    given = {"case.case": "upset_block", "case.friction": 0.3, "measure.columns": ("cycles", "work_units", "steps")}
    problem = am.cases.upset_block(law=am.Coulomb(0.3))
    path = am.LoadPath({"top": [0.5, 1.0, 0.5]})
    steps = am.solve_path(am.Hierarchy.uniform(problem, divisions=(4, 8)), path, am.FullMultigrid())
    found = case_run(**given, **{"hierarchy.divisions": (4, 8), "load_path.top": (0.5, 1.0, 0.5)})
    assert (found["cycles"], found["steps"]) == (sum(step.cycles for step in steps), 3)
    assert found["work_units"] == pytest.approx(sum(step.work_units for step in steps))
    for factors in (None, (0.5, 1.0)):
        with_path = {} if factors is None else {"load_path.top": factors}
        meshes = list(am.adapt(problem, 10e-3, am.Residual(), am.Doerfler(), am.Bisect(), max_nodes=150,
                               load_path=None if factors is None else am.LoadPath({"top": list(factors)})))
        found = case_run(**given, **with_path, **{"adapt.start": 10e-3, "adapt.engine": "bisect",
                                                  "adapt.max_nodes": 150})
        assert found["steps"] == len(meshes) > 1
        assert found["cycles"] == sum(mesh.result.cycles for mesh in meshes)
        assert found["work_units"] == pytest.approx(float(meshes[-1].total_work_units))


def test_whole_numbers_are_numbers_where_an_argument_is_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = SMALL.replace("case.friction = [0.2, 1.0]", "case.size = [1, 3]").replace(
        "[vary]", '[design]\nkind = "sobol"\nruns = 8\nlog = ["case.size"]\n[vary]')
    sizes = [point["case.size"] for point in read(written(text)).design.points()]
    assert len(set(sizes)) == 8 and all(isinstance(size, float) for size in sizes)


@pytest.mark.parametrize(("solver", "wanted"), [
    ({"correction": "paper", "gap": "largest", "slip": "minmod", "limit": "summed", "order": "symmetric"},
     am.FullMultigrid(correction=am.PaperCorrection(gap="largest", slip="minmod", limit="summed"),
                      smoother=am.ProjectedGaussSeidel(order="symmetric"))),
    ({"method": "single-grid", "condensed": True, "omega": 1.3, "max_cycles": 9},
     am.SingleGrid(omega=1.3, condensed=True, max_sweeps=9)),
    ({"method": "multigrid", "correction": "monotone", "shape": "complete", "pre": 1},
     am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="complete", pre=1))),
    ({"correction": "monotone", "coarse.omega": 1.2, "start.rtol": 1e-6, "rtol": 1e-6},
     am.FullMultigrid(correction=am.Monotone(), coarse=am.CoarseSolve(omega=1.2), rtol=1e-6,
                      start=am.FullMultigrid().start.__class__(rtol=1e-6))),
    ({"method": "active-set", "linear": "amg", "max_iterations": 90},
     am.ActiveSet(linear=am.AMG(max_iterations=90)))])
def test_settings_reach_the_method(solver, wanted):
    assert build.solver_of(dict(solver)) == wanted


@pytest.mark.parametrize("method", build.METHODS)
def test_every_listed_default_of_a_method_is_its_default(method):
    """Keys are fields: each of them, set to the default that is listed, leaves the method unchanged."""
    for key, known in build.keys_of(method).items():
        owners = [name for name, kinds in build.OBJECTS.items() for kind in kinds[1:] if key in build.keys_of(kind)]
        # not with the default correction
        projected = issubclass(method, am.Multigrid) and (key.startswith("coarse.") or any(
            key in build.keys_of(kind) for kind in (am.Cycle, am.ProjectedGaussSeidel)))
        if known.default and not owners and not projected and key not in build.keys_of(am.Truncated):
            value = tomllib.loads(f"value = {known.default}")["value"]
            value = float(value) if known.real else value
            assert build.solver_of({"method": build.name_of(method), key: value}) == method(), key


def test_sizes_of_bodies_can_be_varied(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = SMALL.replace('"greco_bar"', '"two_block_patch"').replace("divisions = [2, 4]", "sizes.upper = [0.05, 0.03]")
    said = read(written(text.replace("case.friction = [0.2, 1.0]", "hierarchy.sizes.lower = [[0.05, 0.03], [0.1, 0.06]]"
                                     )))
    assert said.design.names == ("hierarchy.sizes.lower",) and len(checked(said, None)) == 2
    case = am.cases.two_block_patch()
    for factor, point in zip((1, 2), said.design.points(), strict=True):
        found = grids(case, build.section({**said.fixed, **point}, "hierarchy"))
        wanted = am.Hierarchy.graded(case, [{"upper": size, "lower": factor * size} for size in (0.05, 0.03)])
        assert [level.mesh.n_nodes for level in found.levels] == [level.mesh.n_nodes for level in wanted.levels]


@pytest.mark.parametrize("first", [{"divisions": (4,)}, {"sizes": (8e-3,), "contact_ratio": 2.0}])
def test_bisections_at_contact(first):
    case = am.cases.greco_bar()
    begin, found = grids(case, dict(first)), grids(case, {**first, "levels": 2})
    wanted = am.Hierarchy.bisected(case, begin.levels[0].mesh, 2)
    assert len(found.levels) == 3 and found.levels[2].mesh.n_nodes == wanted.levels[2].mesh.n_nodes
    assert (found.levels[0].mesh.points == begin.levels[0].mesh.points).all()


@pytest.mark.parametrize(("adapt", "wanted"), [
    ({"quantity": "displacement", "points": (0.0, 0.0), "component": "x"}, am.Displacement((0.0, 0.0), "x")),
    ({"quantity": "displacement", "points": ((0.0, 0.0), (0.01, 0.0)), "component": "x"},
     am.Displacement(((0.0, 0.0), (0.01, 0.0)), "x")),
    ({"quantity": "mean-displacement", "boundary": "top", "component": "y", "engine": "bisect"},
     am.MeanDisplacement("top", "y")),
    ({"quantity": "opening", "engine": "bisect"}, am.Opening()),
    ({"indicator": "recovery", "engine": "bisect", "mark": "maximum", "theta": 0.3, "passes": 1}, None)])
def test_settings_reach_the_adaptive_loop(adapt, wanted):
    given = {"case.case": "greco_bar", "adapt.max_nodes": 90, "adapt.start": 10e-3, "adapt.indicator": "goal",
             **{f"adapt.{key}": value for key, value in adapt.items()}}
    made = build.adaptation(given)
    assert made["indicator"] == (am.Recovery() if wanted is None else am.Goal(wanted))
    assert made.get("mark") == (am.Maximum(0.3) if "mark" in adapt else None)
    assert made.get("engine") == (am.Bisect(passes=adapt.get("passes")) if "engine" in adapt else None)
    if wanted is None:
        found = case_run(**given, **{"measure.columns": ("estimate", "steps")})
        assert found["outcome"] == "CONVERGED" and found["estimate"] > 0 and found["steps"] >= 1


def test_friction_of_a_case_that_takes_no_law(command):
    made = build.problem_of({"case": "bolted_junction", "friction": 0.35, "head_friction": 0.1})
    points = np.array([[0.1, 0.0], [0.1, 0.05], [0.2, 0.03]])
    wanted = am.cases.bolted_junction(friction=0.35, head_friction=0.1).law
    assert (made.law.friction(points) == wanted.friction(points)).all() and made.law.friction(points).max() == 0.35
    for given in ({"law": "frictionless"}, {"law": "tresca", "friction": 0.3}):
        with pytest.raises(ValueError, match=r"case\.law has no meaning for the case bolted_junction"):
            build.problem_of({"case": "bolted_junction", **given})
    assert "--limit has no meaning for the case" in command("solve", "bolted_junction", "--limit", "1e6")[2]


def test_repeats_and_load_paths_by_boundary(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = SMALL.replace('"greco_bar"', '"cattaneo"')
    text = text.replace("divisions = [2, 4]", "sizes = [10e-3]\ncontact_ratio = 5")
    said = read(written(text.replace("[vary]", "[load_path]\nupper.top = [0.5, 1.0]\n[design]\nrepeats = 3\n[vary]")))
    assert said.fixed["load_path.upper.top"] == (0.5, 1.0) and said.design.names == ("case.friction", "repeat")
    assert [point["repeat"] for point in said.design.points()] == [0, 1, 2] * 2
    assert len(checked(said, None)) == 6



@pytest.mark.parametrize("name", am.cases.names())
def test_the_file_to_begin_with_can_be_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = read(written(study_file.template(name)))
    assert said.name == name and said.fixed["case.case"] == name and len(checked(said, None)) >= 2
    # and with all that stands in comments, but for what excludes each other
    text = re.sub(r"^# (?=\w+ = )(?!law|method)", "", study_file.template(name), flags=re.MULTILINE)
    assert len(tomllib.loads(text)["case"]) > len(tomllib.loads(study_file.template(name))["case"])
    assert len(checked(read(written(text)), None)) >= 2
