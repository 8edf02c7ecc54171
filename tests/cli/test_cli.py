"""The command, ``solve`` and ``adapt``: what they print where, what they write, how they end."""

import contextlib
import io
import json
import logging
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import adaptmg as am
from adaptmg.cli import main
from adaptmg.cli.output import watched

COMMANDS = ("cases", "solve", "adapt", "study", "report", "warm")
SMALL = ("adapt", "upset_block", "--start", "8e-3", "--engine", "bisect", "--max-nodes", "120")


@pytest.mark.parametrize("arguments", [(), *((name,) for name in ("", *COMMANDS))])
def test_every_help_has_an_example(command, arguments):
    code, out, _ = command(*filter(None, arguments), *["--help"] * bool(arguments))
    assert code == 0 and "Example: adaptmg" in out
    if arguments in ((), ("",)):
        places = [out.index(f" {name} ") for name in COMMANDS]
        assert places == sorted(places) and "130 Ctrl-C" in " ".join(out.split())


def test_help_loads_nothing_heavy():
    """That of ``solve`` and ``adapt`` reads the classes."""
    code = (
        "import sys\nfrom adaptmg.cli import main\n"
        "for name in ('', 'cases', 'study', 'report'):\n    try:\n        main([*filter(None, [name]), "
        "'--help'])\n    except SystemExit:\n        pass\n"
        "sys.stderr.write(' '.join(m for m in ('numpy', 'numba', 'pandas', 'matplotlib', 'ngsolve', 'sqlite3') "
        "if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""


def test_cases_are_listed(command):
    version = f"adaptmg {am.__version__}\n"
    assert command("--version") == (0, version, "")
    module = subprocess.run(
        [sys.executable, "-m", "adaptmg", "--version"], capture_output=True, text=True
    )
    assert (module.returncode, module.stdout) == (0, version)
    _, out, _ = command("cases")
    alone, others = out.split("\n\nfrom Python, see 'adaptmg cases NAME':\n")
    assert [row.split()[0] for row in alone.splitlines()] == list(am.cases.CASES)
    assert [row.split()[0] for row in others.splitlines()] == list(am.cases.FROM_PYTHON)
    _, out, _ = command("cases", "--json")
    assert [row["name"] for row in json.loads(out)] == [*am.cases.CASES, *am.cases.FROM_PYTHON]


@pytest.mark.parametrize("case", am.cases.FROM_PYTHON)
def test_cases_from_python_are_solved_by_the_call_that_is_printed(command, case):
    _, out, _ = command("cases", case)
    script = textwrap.dedent(out.split("From Python:\n")[1].split("\n\n")[0])
    names = {}
    exec(script, names)
    solved = names["solved"]
    assert all(
        result.status.ok for result in ([solved] if isinstance(solved, am.Result) else solved)
    )
    code, _, error = command("solve", case)
    assert code == 2 and f"problem = am.cases.{case}()" in error


def test_solve_prints_json_and_nothing_else_to_standard_output(command):
    code, out, _ = command(
        "solve", "greco_bar", "--divisions", "4,8", "--friction", "0.3", "--json"
    )
    row = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert code == 0 and row["status"] == "CONVERGED" and row["error_estimate"] <= row["rtol"]
    assert sum(row["contact"].values()) == row["levels"][-1]["contact_nodes"] == 9
    problem = am.cases.greco_bar(law=am.Coulomb(0.3))
    wanted = am.solve(am.Hierarchy.uniform(problem, divisions=(4, 8)), am.FullMultigrid())
    assert row["max_pressure"] == pytest.approx(float(wanted.contact.pressure.max()), rel=1e-6)


@pytest.mark.parametrize("case", am.cases.CASES)
def test_every_case_is_solved_and_adapted_without_options(command, case):
    """Grids and start sizes follow the domain; the limit of nodes is lower here. No case is beyond
    the theory."""
    code, out, warned = command("solve", case, "--json")
    solved = json.loads(out)
    assert code == 0 and solved["status"] == "CONVERGED" and len(solved["levels"]) >= 2
    assert 400 <= solved["levels"][-1]["nodes"] <= 20_000
    assert solved["contact"]["slip"] + solved["contact"]["stick"] >= 5 or case == "leaning_strut"
    code, out, warned_again = command("adapt", case, "--max-nodes", "1200", "--json")
    adapted = json.loads(out)
    lines = [line for line in (warned + warned_again).splitlines() if "warning" in line]
    # what the strut is about
    assert bool(lines) == (case == "leaning_strut"), lines
    assert all("may not be unique" in line for line in lines)
    assert (
        code == 0
        and adapted["result"]["status"] == "CONVERGED"
        and adapted["steps"][0]["nodes"] <= 1200
    )


def test_arguments_of_the_case_are_set(command):
    code, out, _ = command(
        "solve",
        "greco_block",
        "--divisions",
        "2,4",
        "--set",
        "young=7e10",
        "--set",
        "plane_strain=false",
        "--friction",
        "0.3",
        "--json",
    )
    problem = am.cases.greco_block(law=am.Coulomb(0.3), young=7e10, plane_strain=False)
    wanted = am.solve(am.Hierarchy.uniform(problem, divisions=(2, 4)), am.FullMultigrid())
    assert code == 0 and json.loads(out)["max_displacement"] == float(
        np.linalg.norm(wanted.displacement, axis=1).max()
    )
    assert (
        command("solve", "coulomb_transition", "--set", "kind=stick", "--sizes", "0.2,0.1")[0] == 0
    )


def test_a_run_that_does_not_converge_ends_with_code_1(command):
    code, out, err = command(
        "solve", "greco_bar", "--divisions", "4,8", "--max-cycles", "1", "--json"
    )
    assert code == 1 and json.loads(out)["status"] == "LIMIT"
    assert err.splitlines()[-1].startswith("adaptmg: not converged (LIMIT)")


def test_the_log_goes_to_standard_error_with_a_bar_on_terminals(capsys, monkeypatch):
    logger = logging.getLogger("adaptmg")
    before = (logger.level, list(logger.handlers))
    with watched() as callback:
        logging.getLogger("adaptmg.somewhere").info("compiling [kernels]")
    out, err = capsys.readouterr()
    assert (callback, out, logger.level, logger.handlers) == (
        None,
        "",
        *before,
    ) and "compiling [kernels]" in err
    monkeypatch.setenv("FORCE_COLOR", "1")
    with watched() as callback:
        callback({"cycle": 0, "residual": float("nan")})
        callback({"cycle": 3, "residual": 1e-3, "error_estimate": 2.5e-4})
    assert "cycle 3, error 2.5e-04" in capsys.readouterr().err


def test_a_line_a_step_and_a_tolerance_that_ends_it(command):
    code, out, err = command(*SMALL)
    lines = out.splitlines()
    assert (code, err) == (0, "")
    numbers = [
        int(line.split()[1].rstrip(":"))
        for line in lines[: lines.index("")]
        if line.startswith("step")
    ]
    assert (
        numbers == list(range(len(numbers)))
        and len(numbers) > 1
        and "max_nodes" in out
        and "CONVERGED" in out
    )
    said = json.loads(command(*SMALL[:-2], "--tolerance", "0.1", "--json")[1])
    assert said["steps"][-1]["estimate"] <= 0.1 and "tolerance" in said["outcome"]


@pytest.mark.slow
@pytest.mark.usefixtures("command")
def test_files_are_written_and_what_cannot_be_printed_is_shown_as_codes(tmp_path):
    out = tmp_path / "deep" / "\udcff\xb5\x1b"
    text = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    with contextlib.redirect_stdout(text), pytest.raises(SystemExit) as end:
        main([*SMALL, "--out", str(out)])
    text.seek(0)
    printed = text.read()
    pictures = (
        "problem",
        "grids",
        "deformed",
        "stress",
        "contact",
        "history",
        "adaptation",
        "cycles",
    )
    names = {"result.npz", "result.vtu", *(f"{name}.png" for name in pictures)}
    assert not end.value.code and {p.name for p in out.iterdir()} == names
    assert all(f"/deep/\\udcff\\xb5\\x1b/{name}" in printed for name in names)
    assert np.isfinite(am.Result.load(out / "result.npz").displacement).all()


def test_a_store_is_gone_on_from(command, tmp_path):
    store = ("--store", str(tmp_path / "store"))
    first = json.loads(command(*SMALL, *store, "--json")[1])
    code, out, _ = command(*SMALL, *store, "--json")
    assert code == 0 and json.loads(out)["steps"] == first["steps"]
    code, _, err = command(*SMALL, *store, "--theta", "0.3")
    assert code == 2 and "another run: value of mark differs" in err


def test_a_mesh_that_is_not_solved_ends_with_code_1(command, monkeypatch):
    from adaptmg.estimate import loop

    result = am.solve(
        am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8)),
        am.FullMultigrid(max_cycles=1),
        throw=False,
    )
    monkeypatch.setattr(
        loop.AdaptiveLoop, "steps", lambda self: (_ for _ in ()).throw(am.NotConverged(result))
    )
    code, out, err = command(*SMALL, "--json")
    assert (
        code == 1
        and "not converged" in json.loads(out)["error"]
        and "not converged: " in err.splitlines()[-1]
    )


def test_a_dry_run_forecasts_without_the_fine_grids(command):
    code, said, _ = command("solve", "greco_bar", "--divisions", "4,8,1024", "--dry-run")
    assert code == 0 and said.startswith("about 1050625 nodes, 2101250 unknowns")
    code, said, _ = command("solve", "greco_bar", "--sizes", "8e-3,2e-3", "--dry-run", "--json")
    assert code == 0 and set(json.loads(said)) == {"nodes", "unknowns", "memory", "seconds"}
    assert command("solve", "greco_bar", "--pre", "-1", "--dry-run")[0] == 2


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--sizes=2e-3,8e-3", "from coarse to fine"),
        ("--sizes=a,b", "sizes must be a number, got 'a'"),
        ("--sizes=1e-2,nan", "sizes must be finite, got nan"),
        ("--divisions=8,4", "from coarse to fine"),
        ("--divisions=8,0", "divisions must be >= 1, got 0"),
    ],
)
def test_a_dry_run_refuses_the_grids_that_a_solve_refuses(command, option, message):
    code, _, error = command("solve", "greco_bar", option, "--dry-run")
    assert code == 2 and message in error
