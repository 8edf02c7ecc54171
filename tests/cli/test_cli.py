"""The command: what it prints where, what it writes, how it ends."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import adaptmg as am
from adaptmg.cli import app
from adaptmg.cli.output import watched

COMMANDS = ("cases", "solve", "adapt", "study", "runs", "report")


@pytest.mark.parametrize("arguments", [(), *((name,) for name in ("", *COMMANDS))])
def test_every_help_has_an_example(command, arguments):
    code, out, _ = command(*filter(None, arguments), *["--help"] * bool(arguments))
    assert code == 0 and "Example: adaptmg" in out
    if arguments in ((), ("",)):
        places = [out.index(f" {name} ") for name in COMMANDS]
        assert places == sorted(places) and "130 Ctrl-C" in " ".join(out.split())


def test_help_loads_nothing_heavy():
    code = ("import sys\nfrom adaptmg.cli import app\n"
            f"for name in {COMMANDS}:\n    try:\n        app([name, '--help'])\n    except SystemExit:\n        pass\n"
            "sys.stderr.write(' '.join(m for m in ('numpy', 'numba', 'pandas', 'matplotlib', 'ngsolve', 'sqlite3') "
            "if m in sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""


def test_cases_are_listed(command):
    assert command("--version") == (0, f"adaptmg {am.__version__}\n", "")
    _, out, _ = command("cases")
    assert [row.split()[0] for row in out.splitlines()] == list(am.cases.names())
    _, out, _ = command("cases", "--json")
    assert [row["name"] for row in json.loads(out)] == list(am.cases.names())


def test_solve_prints_json_and_nothing_else_to_standard_output(command):
    code, out, _ = command("solve", "greco_bar", "--divisions", "4,8", "--friction", "0.3", "--json")
    row = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert code == 0 and row["status"] == "CONVERGED" and row["error_estimate"] <= row["rtol"]
    assert sum(row["contact"].values()) == row["levels"][-1]["contact_nodes"] == 9
    problem = am.cases.greco_bar(law=am.Coulomb(0.3))
    wanted = am.solve(am.Hierarchy.uniform(problem, divisions=(4, 8)), am.FullMultigrid())
    assert row["max_pressure"] == pytest.approx(float(wanted.contact.pressure.max()), rel=1e-6)


@pytest.mark.slow
def test_solve_writes_result_pictures_and_vtk(command, tmp_path):
    out = tmp_path / "deep" / "bar"
    code, text, _ = command("solve", "greco_bar", "--divisions", "2,4", "--out", str(out))
    assert code == 0
    names = {"result.npz", "result.vtu", "problem.png", "grids.png", "deformed.png", "stress.png", "contact.png",
             "history.png", "path.png"}
    assert {p.name for p in out.iterdir()} == names
    assert all(str(out / name) in text for name in names)
    assert np.isfinite(am.Result.load(out / "result.npz").displacement).all()


@pytest.mark.parametrize("options", [
    ("--solver", "single-grid", "--omega", "1.5"),
    ("--solver", "multigrid", "--correction", "monotone", "--cycle", "W", "--pre", "1", "--post", "1"),
    ("--solver", "active-set", "--linear", "amg", "--rtol", "1e-9"),
    ("--law", "tresca", "--limit", "1e7"),
    ("--law", "frictionless"),
])
def test_every_method_and_law_gives_its_solution(command, options):
    code, out, _ = command("solve", "curved_obstacle", "--divisions", "4,8", "--json", *options)
    row = json.loads(out)
    assert code == 0 and row["status"] == "CONVERGED" and row["residual"] < 1e-6


def test_arguments_of_the_case_are_set(command):
    code, out, _ = command("solve", "greco_block", "--divisions", "2,4", "--set", "young=7e10", "--set",
                           "plane_strain=false", "--friction", "0.3", "--json")
    problem = am.cases.greco_block(law=am.Coulomb(0.3), young=7e10, plane_strain=False)
    wanted = am.solve(am.Hierarchy.uniform(problem, divisions=(2, 4)), am.FullMultigrid())
    assert code == 0 and json.loads(out)["max_displacement"] == float(
        np.linalg.norm(wanted.displacement, axis=1).max())
    assert command("solve", "bolted_junction", "--set", "bolt=traction", "--sizes", "20e-3,12e-3")[0] == 0


def test_a_run_that_does_not_converge_ends_with_code_1(command):
    code, out, err = command("solve", "greco_bar", "--divisions", "4,8", "--max-cycles", "1", "--json")
    assert code == 1 and json.loads(out)["status"] == "LIMIT"
    assert err.splitlines()[-1].startswith("adaptmg: not converged (LIMIT)")


@pytest.mark.parametrize(("options", "message"), [
    (("greco_bax",), "did you mean 'greco_bar'"),
    (("greco_bar", "--transfer", "l2"), "--transfer has no meaning for uniform grids (without --sizes)"),
    (("greco_bar", "--solver", "single-grid", "--cycle", "W"), "--shape has no meaning"),
    (("greco_bar", "--law", "tresca", "--limit", "1", "--friction", "1"), "it belongs to --law coulomb"),
    (("greco_bar", "--set", "yong=1"), "did you mean 'young'"), (("greco_bar", "--set", "young"), "NAME=VALUE"),
    (("greco_bar", "--set", "young=steel"), "young must be a number"), (("greco_bar", "--set", "young=-1"), "> 0"),
    (("greco_bar", "--set", "friction=1"), "an option of its own"), (("dovetail", "--set", "angle="), "NAME=VALUE"),
])
def test_bad_input_is_one_line_and_code_2(command, options, message):
    code, out, err = command("solve", *options)
    assert code == 2 and out == "" and message in err
    last = [row for row in err.splitlines() if row.startswith("adaptmg: ")]
    assert len(last) == 1 and "Traceback" not in err


def test_the_log_goes_to_standard_error_and_is_put_back_and_a_terminal_gets_a_bar(capsys, monkeypatch):
    logger = logging.getLogger("adaptmg")
    before = (logger.level, list(logger.handlers))
    with watched(1e-8) as callback:
        logging.getLogger("adaptmg.somewhere").info("compiling [kernels]")
    out, err = capsys.readouterr()
    assert (callback, out, logger.level, logger.handlers) == (None, "", *before) and "compiling [kernels]" in err
    monkeypatch.setenv("FORCE_COLOR", "1")
    with watched(1e-8) as callback:
        callback({"cycle": 0, "residual": float("nan"), "error_estimate": float("inf")})
        callback({"cycle": 3, "residual": 1e-3, "error_estimate": 2.5e-4})
    assert "cycle 3, error 2.5e-04" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_ctrl_c_ends_with_130_and_one_line():
    # in a shell's background the signal comes ignored
    code = ("import os, signal, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "from adaptmg.cli import main, solve_case\n"
            "solve_case.solved = lambda *arguments: (os.kill(os.getpid(), signal.SIGINT), time.sleep(60))\nmain()")
    done = subprocess.run([sys.executable, "-c", code, "solve", "greco_bar", "--divisions", "2,4"], capture_output=True,
                          text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "adaptmg: interrupted\n")


def test_what_cannot_be_printed_is_printed_as_codes(monkeypatch):
    from adaptmg.cli import solve_case as work

    monkeypatch.setattr(work, "write", lambda *arguments: [Path("\udcff\xb5\x1b/result.npz")])
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as end:
        app(["solve", "greco_bar", "--divisions", "2,4", "--out", "x"], prog_name="adaptmg")
    out.seek(0)
    assert not end.value.code and "wrote \\udcff\\xb5\\x1b/result.npz" in out.read()
    done = subprocess.run([sys.executable, "-m", "adaptmg", "solve", b"\xff"], capture_output=True,
                          env=os.environ | {"PYTHONIOENCODING": "ascii:strict"})
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"udcff" in done.stderr


def test_pictures_are_whole_or_not_there(command, tmp_path, monkeypatch):
    (tmp_path / "contact.png").write_bytes(b"old")
    monkeypatch.setattr("os.replace", lambda *names: (_ for _ in ()).throw(OSError(28, "disk full")))
    code, out, err = command("solve", "greco_bar", "--divisions", "2,4", "--out", str(tmp_path))
    assert code == 2 and out == "" and "disk full" in err
    assert (tmp_path / "contact.png").read_bytes() == b"old" and not list(tmp_path.glob("*.part"))
