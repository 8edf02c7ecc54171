"""``adaptmg study``: scripts that are run, options, exit codes, JSON; settings that reach methods,
grids and loops."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import adaptmg as am
from adaptmg.cli import build
from adaptmg.cli.build import sections
from adaptmg.study.store import Record, Store

SCRIPT = """
import adaptmg as am

parameters = {"friction": [0.2, 1.0], "cells": [4, 8]}

def run(friction, cells):
    if cells == 3:
        raise ValueError("three")
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(cells // 2, cells))
    result = am.solve(grids, throw=False)
    return {"outcome": result.status.name, "cycles": result.cycles, "force": result.resultant("contact").force[1]}

if __name__ == "__main__":
    raise SystemExit("not run")
"""
ONE = "import adaptmg as am\nstudy = am.Study(lambda n: {'m': 2 * n}, {'n': [1, 2, 3]}, 'one.sqlite', name='one')\n"
RECORDING = """
import json
import pathlib
import adaptmg as am

class Recording(am.Study):
    def run(self, **options):
        pathlib.Path("options.json").write_text(json.dumps(options), encoding="utf-8")
        return super().run(progress=False)

study = Recording(lambda n: {"m": n}, {"n": [1, 2]}, "recording.sqlite")
"""


def written(text: str = SCRIPT) -> str:
    Path("bar.py").write_text(text, encoding="utf-8")
    return "bar.py"


@pytest.fixture(autouse=True)
def modules(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(tmp_path)  # the path is restored in the end
    yield
    sys.modules.pop("bar", None)


def test_a_script_is_run_once_and_gives_what_it_gives_alone(command):
    code, out, err = command("study", written())
    assert code == 0 and "4 done" in out and "[4/4]" in err and "Traceback" not in err
    said = json.loads(command("study", "bar.py", "--json")[1])
    assert said["study"] == "bar" and said["done"] == 4 and Path("results/bar.sqlite").exists()
    result = am.solve(
        am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(1.0)), divisions=(4, 8)), throw=False
    )
    row = said["rows"][3]
    assert (row["friction"], row["cells"], row["cycles"]) == (1.0, 8, result.cycles)
    assert row["force"] == result.resultant("contact").force[1] and row["machine"]
    code, out, _ = command("study", written(ONE), "--json")
    assert (
        code == 0
        and [row["m"] for row in json.loads(out)["rows"]] == [2, 4, 6]
        and Path("one.sqlite").exists()
    )


def test_scripts_run_their_study_on_workers_with_their_neighbours(command):
    Path("neighbour.py").write_text("def f(n):\n    return 3 * n\n", encoding="utf-8")
    code, out, err = command(
        "study",
        written(
            "import adaptmg as am\nfrom neighbour import f\ndef run(n): return {'m': f(n)}\n"
            "study = am.Study(run, {'n': [1, 2]})\nstudy.run(workers=1)\n"
        ),
        "--json",
    )
    sys.modules.pop("neighbour")
    assert code == 0 and [row["m"] for row in json.loads(out)["rows"]] == [3, 6], err


def test_options_reach_the_study(command):
    options = (
        *("--workers", "2", "--rerun", "--retry-failed"),
        *("--limit-s", "9", "--memory-limit", "1e9"),
    )
    assert command("study", written(RECORDING), *options)[0] == 0
    assert json.loads(Path("options.json").read_text(encoding="utf-8")) == {
        "progress": None,
        "workers": 2,
        "scheduler": None,
        "rerun": True,
        "retry_failed": True,
        "limit_s": 9.0,
        "memory_limit": 1e9,
    }


def test_a_script_without_a_study_is_stored_where_an_option_says(command):
    text = "parameters = {'n': [1, 2]}\ndef run(n): return {'m': n}\n"
    assert command("study", written(text), "--store", "two.sqlite")[0] == 0
    assert len(Store("two.sqlite").get("bar")) == 2 and not Path("results").exists()


def test_a_run_that_fails_ends_with_code_1_and_can_be_repeated(command):
    code, out, err = command("study", written(SCRIPT.replace("[4, 8]", "[4, 3]")))
    assert code == 1 and "2 failed" in out
    assert err.splitlines()[-1] == "adaptmg: 2 of 4 runs failed: --retry-failed runs them again"
    before = {
        key: record.finished for key, record in Store("results/bar.sqlite").get("bar").items()
    }
    command("study", "bar.py")
    assert {
        key: record.finished for key, record in Store("results/bar.sqlite").get("bar").items()
    } == before
    command("study", "bar.py", "--retry-failed")
    after = Store("results/bar.sqlite").get("bar")
    assert sum(after[key].finished != before[key] for key in before) == 2


def test_a_dry_run_says_what_there_is(command):
    code, out, _ = command("study", written(), "--dry-run")
    assert code == 0 and "4 missing" in out and out.split()[:3] == ["friction", "cells", "status"]
    assert json.loads(command("study", "bar.py", "--dry-run", "--json")[1])["missing"] == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\n", "run and parameters; it makes 0 studies"),
        (ONE + ONE.replace("study =", "other ="), "makes 2 studies"),
        ("def run(n): return {}\n", "run and parameters"),
        ("x = \n", "SyntaxError"),
        ("import nothing_there\n", "No module"),
    ],
)
def test_a_wrong_script_is_one_line(command, text, words):
    code, out, err = command("study", written(text))
    assert (code, out) == (2, "") and err.count("\n") == 1 and words in err
    assert "--store belongs" in command("study", written(ONE), "--store", "x.sqlite")[2]


def test_what_is_not_a_script_is_refused(command):
    for path in (".", "/dev/zero", "study.toml", "none.py"):
        code, _, err = command("study", path)
        assert (
            code == 2
            and ("there is no file" if path == "none.py" else "must be a Python script that makes")
            in err
        )
    for arguments in (("solve", "nothing"), ("adapt", "nothing"), ("cases", "nothing")):
        assert "there is no case 'nothing'" in json.loads(command(*arguments, "--json")[1])["error"]


def test_quiet_says_nothing_but_errors(command):
    assert command("study", written(), "--quiet") == (0, "", "")
    code, out, err = command("study", written(SCRIPT.replace("[4, 8]", "[3]")), "-q")
    assert (code, out) == (1, "") and err.count("\n") == 3


def test_ctrl_c_says_how_to_go_on_and_the_same_command_does(command):
    written(
        "import time\nparameters = {'n': range(100)}\ndef run(n):\n    time.sleep(.05)\n    return {'m': n}\n"
    )
    # in a shell's background the signal comes ignored
    code = (
        "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nfrom adaptmg.cli import main\n"
        "main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, "study", "bar.py"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while "[2/100]" not in (line := process.stderr.readline()):
        assert line
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130 and out == ""
    assert (
        err.splitlines()[-1]
        == "adaptmg: interrupted: finished runs are stored, the same command goes on"
    )
    done = json.loads(command("study", "bar.py", "--dry-run", "--json")[1])
    assert 2 <= done["done"] < 100 and done["missing"] == 100 - done["done"] and done["stale"] == 0


def test_options_and_cases_are_explained_without_docstrings(command):
    facts = json.loads(command("cases", "bolted_junction", "--json")[1])["arguments"]
    assert facts["friction"]["values"] == "number" and "law" not in facts
    text = command("cases", "cattaneo")[1]
    assert "lower.bottom, upper.top" in text and re.search(
        r"tangential +number, default 15000", text
    )
    assert "did you mean 'dovetail'" in command("cases", "dovetial")[2]
    solver = sections()["solver"]
    assert solver["rtol"] == build.Key("number or {discretisation}", "1e-08")
    assert solver["shape"] == build.Key("{V, W, F, complete}", "V")
    assert sections()["adapt"]["start"] == build.Key("number or file")
    done = subprocess.run(
        [sys.executable, "-OO", "-m", "adaptmg", "solve", "--help"],
        capture_output=True,
        text=True,
    )
    assert not re.search(r"\b(str|int|float|bool|Literal|Sequence|Mapping)\b", done.stdout)
    assert done.returncode == 0 and done.stdout == command("solve", "--help")[1], done.stderr


def test_warnings_are_lines(command):
    code, _, err = command(
        "solve",
        "leaning_strut",
        "--sizes",
        "20e-3,10e-3",
        "--contact-ratio",
        "2",
        "--friction",
        "0.9",
    )
    assert code == 0 and re.search(r"^adaptmg: warning: friction 0.9 exceeds", err, re.MULTILINE)
    assert "RuntimeWarning" not in err and ".py" not in err


@pytest.mark.parametrize(
    ("solver", "wanted"),
    [
        (
            {
                "correction": "paper",
                "gap": "largest",
                "slip": "minmod",
                "limit": "summed",
                "order": "symmetric",
            },
            am.FullMultigrid(
                correction=am.PaperCorrection(gap="largest", slip="minmod", limit="summed"),
                smoother=am.ProjectedGaussSeidel(order="symmetric"),
            ),
        ),
        (
            {"method": "single-grid", "condensed": True, "omega": 1.3, "max_cycles": 9},
            am.SingleGrid(omega=1.3, condensed=True, max_sweeps=9),
        ),
        (
            {"method": "multigrid", "correction": "monotone", "shape": "complete", "pre": 1},
            am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="complete", pre=1)),
        ),
        (
            {"correction": "monotone", "rtol": 1e-6},
            am.FullMultigrid(correction=am.Monotone(), rtol=1e-6),
        ),
        ({"method": "active-set", "linear": "amg"}, am.ActiveSet(linear=am.AMG())),
    ],
)
def test_settings_reach_the_method(solver, wanted):
    assert build.solver_of(dict(solver)) == wanted


@pytest.mark.parametrize("method", build.METHODS)
def test_every_listed_default_of_a_method_is_its_default(method):
    """Keys are fields: each of them, set to the default that is listed, leaves the method
    unchanged."""
    for key, known in build.keys_of(method).items():
        owners = [
            name
            for name, kinds in build.OBJECTS.items()
            for kind in kinds[1:]
            if key in build.keys_of(kind)
        ]
        # not with the default correction
        projected = issubclass(method, am.Multigrid) and any(
            key in build.keys_of(kind) for kind in (am.Cycle, am.ProjectedGaussSeidel)
        )
        if (
            known.default
            and not owners
            and not projected
            and key not in build.keys_of(am.Truncated)
        ):
            value = build._value_of(known.default)
            assert build.solver_of({"method": build.name_of(method), key: value}) == method(), key


@pytest.mark.parametrize(
    ("adapt", "wanted"),
    [
        (
            {"quantity": "displacement", "points": (0.0, 0.0), "component": "x"},
            am.Displacement((0.0, 0.0), "x"),
        ),
        (
            {"quantity": "displacement", "points": ((0.0, 0.0), (0.01, 0.0)), "component": "x"},
            am.Displacement(((0.0, 0.0), (0.01, 0.0)), "x"),
        ),
        (
            {
                "quantity": "mean-displacement",
                "boundary": "top",
                "component": "y",
                "engine": "bisect",
            },
            am.MeanDisplacement("top", "y"),
        ),
        ({"quantity": "opening", "engine": "bisect"}, am.Opening()),
        ({"indicator": "recovery", "engine": "bisect", "mark": "maximum", "theta": 0.3}, None),
    ],
)
def test_settings_reach_the_adaptive_loop(adapt, wanted):
    made = build.arguments_of(
        am.adapt, {"max_nodes": 90, "start": 10e-3, "indicator": "goal", **adapt}, "adapt.", ""
    )
    assert (
        made["indicator"] == (am.Recovery() if wanted is None else am.Goal(wanted))
        and made["start"] == 10e-3
    )
    assert made.get("mark") == (am.Maximum(0.3) if "mark" in adapt else None)
    assert made.get("engine") == (am.Bisect() if "engine" in adapt else None)


def test_laws_and_elements_of_cases(command):
    assert build.problem_of({"case": "greco_bar", "law": "tresca", "limit": 1e7}).law.limit == 1e7
    assert (
        build.problem_of({"case": "bolted_junction", "elements": "smoothed"}).elements == "smoothed"
    )
    made = build.problem_of({"case": "bolted_junction", "friction": 0.35})
    points = np.array([[0.1, 0.0], [0.1, 0.05], [0.2, 0.03]])
    wanted = am.cases.bolted_junction(friction=0.35).law
    assert (made.law.friction(points) == wanted.friction(points)).all() and made.law.friction(
        points
    ).max() == 0.35
    for given in ({"law": "frictionless"}, {"law": "tresca", "friction": 0.3}):
        with pytest.raises(
            ValueError, match=r"case\.law has no meaning for the case bolted_junction"
        ):
            build.problem_of({"case": "bolted_junction", **given})
    assert (
        "--limit has no meaning for the case"
        in command("solve", "bolted_junction", "--limit", "1e6")[2]
    )


@pytest.fixture
def report(command):
    """``adaptmg report``: exit code, standard error."""
    return lambda *arguments: command("report", *arguments)[::2]


def failed_run(name: str = "first") -> None:
    """Three runs, one of which failed, with texts that a page must escape."""

    def run(n, law):
        if n == 3:
            raise ValueError("three <b>&</b> more")
        return {"m": n * 0.5, "w": 2.0 * n}

    am.Study(run, {"n": [1, 2, 3], "law": ["<i>"]}, "s.sqlite", name=name).run(progress=False)


def test_a_page_and_its_table_stand_beside_the_store(report):
    failed_run()
    code, err = report("s.sqlite")
    assert code == 0 and "wrote first.html and first.csv" in err
    page = Path("first.html").read_text(encoding="utf-8")
    assert "data:image/svg+xml" in page and "three &lt;b&gt;" in page and "<b>&</b>" not in page
    assert pd.read_csv("first.csv")["m"].dropna().tolist() == [0.5, 1.0]
    assert report("s.sqlite", "--result", "w", "--unit", "w=kPa", "--to", "other.html")[0] == 0
    other = Path("other.html").read_text(encoding="utf-8")
    assert other.count("<img") < page.count("<img")
    assert other.count("kPa") >= 1 and "kPa" not in page
    assert (
        "units names columns the table does not have: ['v']"
        in (report("s.sqlite", "--unit", "v=m")[1])
    )
    assert "--unit must be NAME=VALUE, got 'w'" in report("s.sqlite", "--unit", "w")[1]


def test_a_page_says_what_all_runs_share_and_when_they_ran(report):
    store = Store("s.sqlite")
    same = {"case.case": "greco_bar", "h.sizes": (0.01, 5e-3)}
    store.put(
        "study",
        [
            Record(
                parameters=same | {"case.friction": k / 2},
                status="done",
                machine="node7",
                results={"max_pressure": 1e6 * k, "text": "\udcff"},
                commit="c" * 40,
                finished=f"2026-01-0{k}T10:00:00",
            )
            for k in range(1, 4)
        ],
    )
    assert report("s.sqlite")[0] == 0
    page = Path("study.html").read_text(encoding="utf-8")
    for words in (
        "case.case = greco_bar, h.sizes = (0.01, 0.005)",
        "[s]",
        "node7",
        "cccccccccccc<",
        "2026-01-01T10:00 to 2026-01-03T10:00 UTC",
        r"\udcff",
    ):
        assert words in page, words
    code, err = report("s.sqlite", "--to", "study.csv")
    assert code == 2 and "must be an HTML file" in err


def test_what_cannot_be_shown_is_told(report):
    failed_run()
    assert "there is no file" in report("none.sqlite")[1]
    code, err = report("s.sqlite", "--result", "cycles")
    assert code != 0 and "cycles" in err and "Traceback" not in err
    failed_run("second")
    assert "give --study, one of first, second" in report("s.sqlite")[1]
    assert "did you mean 'first'" in report("s.sqlite", "--study", "frist")[1]
