"""Studies: nothing is lost, nothing is computed twice, nothing stale is taken for fresh."""

import contextlib
import functools
import math
import time

import numba
import numpy as np
import pandas as pd
import pytest

import adaptmg as am
from adaptmg.study import execute
from adaptmg.study.designs import canonical
from adaptmg.study.execute import compute
from adaptmg.study.store import Record, Store
from adaptmg.study.study import in_order

CALLS: list[dict] = []
GRID = {"sweeps": [1, 2, 3], "friction": [0.0, 1.0]}


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """The versions of the libraries here, which a test may change."""
    CALLS.clear()
    versions = {"python": "3", "numpy": "1"}
    monkeypatch.setattr(execute, "environment", versions.copy)
    return versions


def case(sweeps, friction=0.3):
    CALLS.append({"sweeps": sweeps, "friction": friction})
    if sweeps == 3:
        raise RuntimeError("three is too many")
    return {
        "work": np.float64(sweeps) * friction,
        "cycles": np.int64(10 - sweeps),
        "ok": np.bool_(True),
        "kind": "v",
    }


def another(sweeps, friction=0.3):
    CALLS.append({"sweeps": sweeps, "friction": friction})
    return {"work": 0.0}


def sweep(*given, **options):
    """A study whose runs say that they ran."""
    return am.Study(*given, depends={"CALLS": None}, **options)


def test_rows_come_in_grid_order_with_plain_results():
    table = sweep(case, {"sweeps": [2, 1], "friction": np.array([0.5, 1.0])}).run(progress=False)
    assert list(zip(table["sweeps"], table["friction"], strict=True)) == [
        (2, 0.5),
        (2, 1.0),
        (1, 0.5),
        (1, 1.0),
    ]
    assert table["work"].tolist() == [1.0, 2.0, 0.5, 1.0]
    assert table["cycles"].tolist() == [8, 8, 9, 9]
    assert list(table.columns) == [
        "sweeps",
        "friction",
        "work",
        "cycles",
        "ok",
        "kind",
        "status",
        "seconds",
        "error",
    ]
    assert (table["status"] == "done").all() and (table["seconds"] >= 0).all()


def test_a_failed_run_is_a_row_and_is_tried_again(tmp_path):
    path = tmp_path / "deep" / "store.sqlite"
    table = sweep(case, GRID, path).run(progress=False)
    assert table["status"].tolist() == ["done"] * 4 + ["failed"] * 2
    assert table["error"].tolist()[-1] == "RuntimeError: three is too many" and np.isnan(
        table["work"].iloc[-1]
    )
    CALLS.clear()
    pd.testing.assert_frame_equal(
        sweep(case, GRID, path).run(progress=False).iloc[:4], table.iloc[:4]
    )
    assert [c["sweeps"] for c in CALLS] == [3, 3]
    sweep(case, GRID, path).run(progress=False, retry_failed=False)
    assert len(CALLS) == 2
    sweep(case, GRID, path).run(progress=False, rerun=True)
    assert len(CALLS) == 8


@pytest.mark.parametrize("how", ["throw", "interrupt"])
def test_rows_before_an_end_are_stored(tmp_path, how):
    def run(n):
        if n == 2:
            raise KeyboardInterrupt if how == "interrupt" else RuntimeError("two")
        return {"m": 1 / n if how == "interrupt" else n}

    study = am.Study(run, {"n": range(4)}, tmp_path / "s.sqlite")
    ends = {
        "throw": (RuntimeError, "two"),
        "interrupt": (KeyboardInterrupt, r"2 of 4 runs are stored; run\(\) computes the rest"),
    }
    kind, text = ends[how]
    with pytest.raises(kind, match=text) as raised:
        study.run(progress=False, throw=how == "throw")
    assert raised.value.__cause__ is None
    assert how == "throw" or raised.value.__suppress_context__
    # the first run divides by zero where the third one interrupts the study
    states = {
        "throw": ["done", "done", "failed", "missing"],
        "interrupt": ["failed", "done", "missing", "missing"],
    }
    assert study.table()["status"].tolist() == states[how]


def test_a_changed_function_or_version_makes_rows_stale(tmp_path, machine):
    path = tmp_path / "s.sqlite"
    sweep(case, {"sweeps": [1, 2]}, path, name="one").run(progress=False)
    changed = sweep(another, {"sweeps": [1, 2]}, path, name="one")
    assert changed.table()["status"].tolist() == ["stale", "stale"]
    assert changed.run(progress=False)["work"].tolist() == [0.0, 0.0]
    assert changed.table()["status"].tolist() == ["done", "done"]
    machine.update(numpy="2", new="3")
    assert changed.status().reasons == {"package numpy 1 -> 2": 2, "package new is new": 2}
    assert "stale: package new is new (2)" in repr(changed.status())


def test_a_mended_function_computes_only_points_that_were_wrong(tmp_path):
    """As the how-to on studies says: a study of these points, under the same name."""
    path = tmp_path / "s.sqlite"
    grid = {"n": [1, 0, 2], "m": [1.5, 2.5]}
    am.Study(lambda n, m: {"x": m / n}, grid, path, name="s").run(progress=False)
    calls = []

    def mended(n, m):
        calls.append((n, m))
        return {"x": m / (n or 4)}

    study = am.Study(mended, grid, path, name="s", depends={"calls": None})
    wrong = study.table().query("error != ''")
    am.Study(mended, wrong[list(study.parameters)], path, name="s", depends={"calls": None}).run(
        progress=False
    )
    table = study.table()
    assert calls == [(0, 1.5), (0, 2.5)]
    assert table["x"].tolist() == [1.5, 2.5, 0.375, 0.625, 0.75, 1.25]
    assert table["status"].tolist() == ["stale"] * 2 + ["done"] * 2 + ["stale"] * 2


def test_a_file_changed_by_others_is_not_blamed_on_runs(tmp_path):
    file = tmp_path / "data.txt"
    file.write_text("1", encoding="utf-8")

    def run(n):
        value = int(file.read_text(encoding="utf-8"))
        file.write_text("2", encoding="utf-8")
        return {"m": value}

    study = am.Study(run, {"n": [1]}, depends={"data": file, "file": None})
    assert study.run(progress=False)["m"][0] == 1 and study.table()["status"][0] == "stale"
    assert study.run(progress=False)["m"][0] == 2 and study.table()["status"][0] == "done"


def test_meshes_on_which_runs_solve_do_not_make_their_rows_stale(tmp_path):
    grids = am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 12e-3, 8e-3), contact_ratio=2)

    def run(friction):
        law = am.Coulomb(friction)
        return {"cycles": am.solve(grids.with_problem(am.cases.greco_bar(law=law))).cycles}

    study = am.Study(run, {"friction": [0.1, 0.5]}, tmp_path / "s.sqlite")
    study.run(progress=False)
    assert study.table()["status"].tolist() == ["done", "done"]
    grids.timings["mesh"] += 1.0  # as in another process
    assert study.table()["status"].tolist() == ["done", "done"]


def test_a_store_holds_several_studies_by_fixed_parameters(tmp_path):
    path = tmp_path / "s.sqlite"
    for friction in (0.5, 1.0):
        table = sweep(case, {"sweeps": [1, 2]}, path, fixed={"friction": friction}).run(
            progress=False
        )
        assert table["work"].tolist() == [friction, 2 * friction]
        assert table.attrs["study"] == "case" and table.attrs["fixed"] == {"friction": friction}
    sweep(another, {"sweeps": [1]}, path).run(progress=False)
    assert len(CALLS) == 5
    assert Store(path).studies() == ["another", "case"] and len(Store(path).get("case")) == 4


def test_long_runs_and_runs_without_a_record_go_first():
    stored = {
        n: Record(parameters={"n": n}, status="done", seconds=known, results={"cost": known})
        for n, known in ((0, 1.0), (2, 5.0), (3, math.nan))
    }
    todo = {canonical({"n": n}): ({"n": n}, stored.get(n)) for n in range(4)}
    for cost, order in (("seconds", [1, 3, 2, 0]), ("cost", [1, 3, 2, 0]), ("n", [3, 2, 1, 0])):
        assert [point["n"] for point, _ in in_order(todo, cost).values()] == order
    with pytest.raises(TypeError, match="cost must be"):
        in_order(todo, 3)
    table = am.Study(lambda n: {"began": time.monotonic_ns()}, {"n": range(4)}).run(
        progress=False, cost="n"
    )
    assert table["began"].is_monotonic_decreasing


async def coroutine(sweeps):
    return {"m": sweeps}


def generator(sweeps):
    yield {"m": sweeps}


@pytest.mark.parametrize(
    ("run", "parameters", "fixed", "error", "match"),
    [
        (case, {}, None, TypeError, "parameters"),
        (case, {"sweeps": []}, None, ValueError, "empty"),
        (case, {"sweeps": "abc"}, None, TypeError, "list of values"),
        (case, {"sweeps": 3}, None, TypeError, "fixed"),
        (case, {"sweeps": [1, 1]}, None, ValueError, "twice"),
        (case, {"sweep": [1]}, None, TypeError, "does not take"),
        (case, {"sweeps": [1]}, {"sweeps": 2}, ValueError, "both"),
        *(
            (case, {"sweeps": [value]}, None, TypeError, "sweeps")
            for value in ([1, 2], {"a": 1}, object(), (1, [2]), np.array([1.0, 2.0]), 1j)
        ),
        (functools.partial(case, friction=1.0), {"sweeps": [1]}, None, TypeError, "plain function"),
        (coroutine, {"sweeps": [1]}, None, TypeError, "generator or a coroutine"),
        (generator, {"sweeps": [1]}, None, TypeError, "generator or a coroutine"),
    ],
)
def test_a_wrong_study_is_refused_before_anything_runs(run, parameters, fixed, error, match):
    with pytest.raises(error, match=match):
        am.Study(run, parameters, fixed=fixed)
    assert not CALLS


@pytest.mark.parametrize(
    ("returned", "match"),
    [
        (3.0, "must return a dict"),
        ({"n": 1}, "a parameter.*solver_n"),
        ({"a": [1]}, "must be a number"),
        ({1: 1}, "must be strings"),
    ],
)
def test_results_that_cannot_be_stored_end_the_first_run(tmp_path, returned, match):
    done = []

    def run(n):
        done.append(n)
        return {"m": n} if n == 2 else returned

    study = am.Study(
        run, {"n": [1, 2, 3]}, tmp_path / "s.sqlite", depends={"done": None, "returned": None}
    )
    with pytest.raises(ValueError, match=f"cannot be used: .*{match}"):
        study.run(progress=False)
    assert done == [1] and study.status().missing == 3
    # later ones are failures, as one run must not end the others
    study = am.Study(run, {"n": [2, 3]}, depends={"done": None, "returned": None})
    assert study.run(progress=False)["status"].tolist() == ["done", "failed"]


def test_names_of_columns_are_free(tmp_path):
    def run(error, run_status):
        status = am.Status.CONVERGED if error else 1 / error
        return {"status": status, "seconds": 7.5 + run_status}

    study = am.Study(run, {"error": [1, 0], "run_status": [2]}, tmp_path / "s.sqlite")
    table = study.run(progress=False, cost="seconds")
    assert table["error"].tolist() == [1, 0] and table["run_status"].tolist() == [2, 2]
    assert table["status"][0] == "CONVERGED" and table["seconds"][0] == 9.5
    assert table.attrs["columns"]["status"] == "run_run_status"
    assert table["run_run_status"].tolist() == ["done", "failed"]
    assert (table["run_seconds"] < 5).all() and "division" in table["run_error"][1]
    assert study.table(details=True)["traceback"][1]
    page = am.export.study_report(table, tmp_path / "s.html", parameters=["error"])
    text = page.read_text(encoding="utf-8")
    assert "2 runs, 1 done, 1 failed" in text and "division by zero" in text


def test_seconds_contain_no_compiling():
    """Neither of adaptmg's kernels nor of others."""

    def run(n):
        begin = time.perf_counter()
        code = "\n".join(f"    if x > {k}: x = math.sin(x) + {k}" for k in range(50))
        made = {"math": math}
        exec(f"def f(x):\n{code}\n    return x", made)
        numba.njit(made["f"])(1.5)
        return {"wall": time.perf_counter() - begin}

    table = am.Study(run, {"n": [1]}, depends={"exec": None}).run(progress=False)
    assert table["wall"][0] > 0.2 and table["seconds"][0] < 0.2 * table["wall"][0]


@pytest.mark.parametrize(
    ("returned", "match"),
    [
        ({"r": 10**5000}, "ValueError"),
        ({"a": np.ma.array([1, 2], mask=[False, True])}, "mask would be lost"),
    ],
)
def test_results_that_cannot_be_stored_are_failures(returned, match):
    table = am.Study(lambda n: returned, {"n": [1]}, depends={"returned": None}).run(progress=False)
    assert table["status"].tolist() == ["failed"] and match in table["error"].iloc[0]


@pytest.mark.parametrize("name", ["rerun", "retry_failed", "throw"])
def test_options_that_are_true_or_false_are_booleans(name):
    with pytest.raises(TypeError, match=f"{name} must be True or False"):
        sweep(case, {"sweeps": [1]}).run(progress=False, **{name: "no"})


class OddBaseError(BaseException):
    def __str__(self):
        raise GeneratorExit


@pytest.mark.parametrize(
    "error", [SystemExit(3), GeneratorExit(), OddBaseError(), KeyboardInterrupt()]
)
def test_any_exception_of_a_run_is_its_failure(error):
    def run(n):
        raise error

    found = compute(run, {"n": 1}, interruptible=False)
    assert found.record.error.startswith(f"{type(error).__name__}: ") and found.exception is error
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            compute(run, {"n": 1})
    else:
        table = am.Study(run, {"n": [1, 2]}, depends={"error": None}).run(progress=False)
        assert table["status"].tolist() == ["failed", "failed"]


def test_each_run_is_reported(capsys, caplog):
    reported, study = [], am.Study(lambda n: {"m": 1 / n}, {"n": [1, 0, 2]}, name="s")
    caplog.set_level("INFO", logger="adaptmg.study")
    study.run(lambda watch: reported.append((watch.name, watch.done, watch.total, watch.failed)))
    assert (
        reported == [("s", 1, 3, 0), ("s", 2, 3, 1), ("s", 3, 3, 1)]
        and capsys.readouterr().err == ""
    )
    study.run(progress=False, rerun=True)
    assert (
        "study s: [2/3] n=0 failed: ZeroDivisionError" in caplog.text
        and "[1/3] n=1 done" in caplog.text
    )
    study.run(progress=True)
    out, err = capsys.readouterr()
    assert out == "" and "3/3" in err and "1 failed, 0 left" in err
    for progress in (None, True):
        with contextlib.redirect_stderr(None):
            table = sweep(case, {"sweeps": [1]}).run(progress=progress)
        assert table["status"].tolist() == ["done"]


def test_tables_name_units():
    table = pd.DataFrame(
        {"mesh <h>": ["33 x 33", "a&b"], "seconds": [0.123456, float("nan")], "ok": [True, False]}
    )
    text = am.study.as_text(
        table,
        caption="Table 1",
        note="rtol 1e-8",
        units={"seconds": "s"},
        formats={"seconds": ".2f"},
    )
    assert text.splitlines()[1].split("  ")[1:3] == ["seconds [s]", "ok"] and "0.12  yes" in text
