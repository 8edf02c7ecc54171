"""Studies: nothing is lost, nothing is computed twice, nothing stale is taken for fresh."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pandas as pd
import pytest

from adaptmg.study import Study, as_html, as_text, study
from adaptmg.study.record import canonical, parameter_value, restored
from adaptmg.study.store import Store

CALLS: list[dict] = []


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    CALLS.clear()
    monkeypatch.setattr(study, "environment", lambda: {"python": "3", "numpy": "1"})


def case(sweeps, friction=0.3):
    CALLS.append({"sweeps": sweeps, "friction": friction})
    if sweeps == 3:
        raise RuntimeError("three is too many")
    return {"work": np.float64(sweeps) * friction, "cycles": np.int64(10 - sweeps), "ok": np.bool_(True), "kind": "v"}


def another(sweeps, friction=0.3):
    CALLS.append({"sweeps": sweeps, "friction": friction})
    return {"work": 0.0}


GRID = {"sweeps": [1, 2, 3], "friction": [0.0, 1.0]}


def test_rows_come_in_grid_order_with_plain_results():
    table = Study(case, {"sweeps": [2, 1], "friction": np.array([0.5, 1.0])}).run(progress=False)
    assert list(zip(table["sweeps"], table["friction"], strict=True)) == [(2, 0.5), (2, 1.0), (1, 0.5), (1, 1.0)]
    assert table["work"].tolist() == [1.0, 2.0, 0.5, 1.0]
    assert table["cycles"].tolist() == [8, 8, 9, 9]
    assert list(table.columns) == ["sweeps", "friction", "work", "cycles", "ok", "kind", "status", "seconds", "error"]
    assert (table["status"] == "done").all() and (table["seconds"] >= 0).all()


def test_a_failed_run_is_a_row_and_is_tried_again(tmp_path):
    path = tmp_path / "deep" / "store.sqlite"
    table = Study(case, GRID, path).run(progress=False)
    assert table["status"].tolist() == ["done"] * 4 + ["failed"] * 2
    assert table["error"].tolist()[-1] == "RuntimeError: three is too many"
    assert np.isnan(table["work"].iloc[-1])
    CALLS.clear()
    again = Study(case, GRID, path).run(progress=False)
    assert [c["sweeps"] for c in CALLS] == [3, 3]
    pd.testing.assert_frame_equal(again.iloc[:4], table.iloc[:4])


def test_throw_raises_but_keeps_the_row(tmp_path):
    sweep = Study(case, GRID, tmp_path / "s.sqlite")
    with pytest.raises(RuntimeError, match="three"):
        sweep.run(progress=False, throw=True)
    assert sweep.table()["status"].tolist() == ["done"] * 4 + ["failed", "missing"]


def test_rerun_computes_everything_anew(tmp_path):
    sweep = Study(case, {"sweeps": [1, 2]}, tmp_path / "s.sqlite")
    sweep.run(progress=False)
    sweep.run(progress=False)
    assert len(CALLS) == 2
    sweep.run(progress=False, rerun=True)
    assert len(CALLS) == 4


def test_a_changed_function_makes_rows_stale(tmp_path):
    path = tmp_path / "s.sqlite"
    Study(case, {"sweeps": [1, 2]}, path, name="one").run(progress=False)
    changed = Study(another, {"sweeps": [1, 2]}, path, name="one")
    assert changed.table()["status"].tolist() == ["stale", "stale"]
    assert changed.run(progress=False)["work"].tolist() == [0.0, 0.0]
    assert changed.table()["status"].tolist() == ["done", "done"]


def test_a_changed_version_makes_rows_stale(tmp_path, monkeypatch):
    sweep = Study(case, {"sweeps": [1]}, tmp_path / "s.sqlite")
    sweep.run(progress=False)
    monkeypatch.setattr(study, "environment", lambda: {"python": "3", "numpy": "2"})
    assert sweep.table()["status"].tolist() == ["stale"]
    sweep.run(progress=False)
    assert len(CALLS) == 2


def test_a_store_holds_several_studies_and_fixed_parameters_count(tmp_path):
    path = tmp_path / "s.sqlite"
    for friction in (0.5, 1.0):
        table = Study(case, {"sweeps": [1, 2]}, path, fixed={"friction": friction}).run(progress=False)
        assert table["work"].tolist() == [friction, 2 * friction]
        assert table.attrs == {"study": "case", "fixed": {"friction": friction}}
    Study(another, {"sweeps": [1]}, path).run(progress=False)
    assert len(CALLS) == 5
    assert Store(path).studies() == ["another", "case"]
    assert len(Store(path).get("case")) == 4


def test_nothing_is_lost_when_the_process_is_killed(tmp_path):
    path = tmp_path / "s.sqlite"
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent("""
        import os, signal, sys
        from adaptmg.study import Study, study
        study.environment = lambda: {"python": "3", "numpy": "1"}

        def slow(n):
            if n == 3 and "--kill" in sys.argv:
                os.kill(os.getpid(), signal.SIGKILL)
            return {"square": n * n}

        table = Study(slow, {"n": range(5)}, sys.argv[1]).run(progress=False)
        sys.stdout.write(str(table["square"].tolist()))
    """))
    killed = subprocess.run([sys.executable, str(script), str(path), "--kill"], capture_output=True)
    assert killed.returncode == -signal.SIGKILL
    before = Store(path).get("slow")
    assert [r.results["square"] for r in before.values()] == [0, 1, 4]
    resumed = subprocess.run([sys.executable, str(script), str(path)], capture_output=True, text=True)
    assert resumed.stdout == "[0, 1, 4, 9, 16]", resumed.stderr
    after = Store(path).get("slow")
    assert all(after[key] == before[key] for key in before)


@pytest.mark.parametrize("value", [[1, 2], {"a": 1}, object(), (1, [2]), np.array([1.0, 2.0]), 1j])
def test_values_that_cannot_be_stored_are_refused(value):
    with pytest.raises(TypeError, match="sweeps"):
        Study(case, {"sweeps": [value]})


@pytest.mark.parametrize("value", [1, -2.5, "a", True, None, (1, (2.0, "b")), float("inf"), np.float32(0.5)])
def test_values_come_back_from_their_text(value):
    import json

    plain = parameter_value("x", value)
    back = restored(json.loads(canonical({"x": plain}))["x"])
    assert back == plain and type(back) is type(plain)


def test_a_run_does_not_depend_on_the_order_of_parameters():
    assert canonical({"a": 1, "b": (2, "c")}) == canonical({"b": (2, "c"), "a": 1})
    assert canonical({"a": 1}) != canonical({"a": 1.0})


@pytest.mark.parametrize(("parameters", "fixed", "error", "match"), [
    ({}, None, TypeError, "parameters"),
    ({"sweeps": []}, None, ValueError, "empty"),
    ({"sweeps": "abc"}, None, TypeError, "sequence"),
    ({"sweeps": 3}, None, TypeError, "sequence"),
    ({"sweeps": [1, 1]}, None, ValueError, "twice"),
    ({"sweep": [1]}, None, TypeError, "does not take"),
    ({"friction": [1]}, None, TypeError, "does not take"),
    ({"sweeps": [1]}, {"sweeps": 2}, ValueError, "both"),
    ({"sweeps": [1], "status": [1]}, None, ValueError, "column"),
])
def test_a_wrong_grid_is_refused_before_anything_runs(parameters, fixed, error, match):
    with pytest.raises(error, match=match):
        Study(case, parameters, fixed=fixed)
    assert not CALLS


@pytest.mark.parametrize(("returned", "match"), [
    (3.0, "must return a dict"),
    ({"x": [1, 2]}, "reduce arrays"),
    ({"n": 1}, "a parameter"),
    ({"status": "CONVERGED"}, "solver_status"),
    ({1: 1}, "strings"),
])
def test_results_that_cannot_be_stored_are_failures(returned, match):
    def wrong(n):
        return returned

    table = Study(wrong, {"n": [1]}).run(progress=False)
    assert table["status"].tolist() == ["failed"]
    assert match in table["error"].iloc[0]


def test_only_plain_functions_are_taken():
    import functools

    with pytest.raises(TypeError, match="plain function"):
        Study(functools.partial(case, friction=1.0), {"sweeps": [1]})


def test_an_interrupt_stops_the_study_and_keeps_its_rows(tmp_path):
    def interrupted(n):
        if n == 2:
            raise KeyboardInterrupt
        return {"m": n}

    sweep = Study(interrupted, {"n": [0, 1, 2, 3]}, tmp_path / "s.sqlite")
    with pytest.raises(KeyboardInterrupt):
        sweep.run(progress=False)
    assert sweep.table()["status"].tolist() == ["done", "done", "missing", "missing"]


def test_a_file_that_is_no_store_is_refused(tmp_path):
    import sqlite3

    text = tmp_path / "a.txt"
    text.write_text("this is not a database, and it is long enough to be told from an empty one" * 20)
    with pytest.raises(ValueError, match="not a store"):
        Store(text)
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE mine (x)")
    with pytest.raises(ValueError, match="not a store"):
        Store(other)


def test_a_function_is_told_of_each_run(capsys):
    told = []
    study = Study(lambda n: {"m": 1 / n}, {"n": [1, 0, 2]}, name="told")
    study.run(lambda watch: told.append((watch.name, watch.done, watch.total, watch.failed)))
    assert told == [("told", 1, 3, 0), ("told", 2, 3, 1), ("told", 3, 3, 1)]
    assert capsys.readouterr().err == ""


def test_a_progress_bar_goes_to_standard_error(capsys):
    Study(case, {"sweeps": [1, 2]}).run(progress=True)
    out, err = capsys.readouterr()
    assert out == "" and "2/2" in err


@pytest.mark.parametrize("progress", [None, True])
def test_a_process_without_standard_error_runs_a_study(progress, monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    assert Study(case, {"sweeps": [1]}).run(progress=progress)["status"].tolist() == ["done"]


def test_two_processes_may_write_to_one_store(tmp_path):
    path = tmp_path / "s.sqlite"
    first, second = Study(case, {"sweeps": [1]}, path), Study(case, {"sweeps": [2]}, path)
    first.run(progress=False)
    second.run(progress=False)
    assert len(Store(path).get("case")) == 2
    assert os.path.getsize(path) > 0


def test_a_store_is_made_once_by_processes_that_start_together(tmp_path):
    code = ("import sys\nfrom adaptmg.study.store import Store\nfrom adaptmg.study.record import Record\n"
            "sys.stdout.write('x'); sys.stdout.flush(); sys.stdin.read(1)\n"
            "Store(sys.argv[1]).put(sys.argv[2], Record(parameters={}, status='done'))\n")
    path = tmp_path / "s.sqlite"
    started = [subprocess.Popen([sys.executable, "-c", code, str(path), f"study {k}"], stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE) for k in range(4)]
    for process in started:
        process.stdout.read(1)
    for process in started:
        process.communicate(b"x")
    assert [process.returncode for process in started] == [0] * 4
    assert Store(path).studies() == [f"study {k}" for k in range(4)]


def test_a_store_that_cannot_be_written_is_read(tmp_path):
    Study(case, {"sweeps": [1]}, tmp_path / "s.sqlite").run(progress=False)
    sweep = Study(case, {"sweeps": [1]}, tmp_path / "s.sqlite")
    sweep._store._connection.execute("PRAGMA query_only = ON")
    sweep._store._prepare()
    assert sweep.table()["status"].tolist() == ["done"]
    with pytest.raises(OSError, match=r"s\.sqlite: .*write-protected"):
        sweep.run(progress=False, rerun=True)


TABLE = pd.DataFrame({"mesh <h>": ["33 x 33", "a&b"], "seconds": [0.123456, float("nan")], "cycles": [12, 7],
                      "ok": [True, False]})


def test_text_tables_align_and_name_units():
    text = as_text(TABLE, caption="Table 1", note="rtol 1e-8", units={"seconds": "s"}, formats={"seconds": ".2f"})
    assert text.splitlines() == ["Table 1",
                                 "mesh <h>  seconds [s]  cycles  ok",
                                 "--------  -----------  ------  ---",
                                 "33 x 33          0.12      12  yes",
                                 "a&b                 -       7  no",
                                 "rtol 1e-8"]


def test_html_tables_escape_everything():
    page = as_html(TABLE, caption="<script>", note="x < y")
    assert "<script>" not in page and "&lt;script&gt;" in page
    assert "mesh &lt;h&gt;" in page and "a&amp;b" in page and "x &lt; y" in page
    assert '<td class="n">12</td>' in page


def test_units_of_unknown_columns_are_refused():
    with pytest.raises(ValueError, match="second"):
        as_text(TABLE, units={"second": "s"})


def test_a_changed_helper_of_the_script_makes_rows_stale(tmp_path):
    """Helpers in the script of the run function, and in modules beside it that the script uses, are seen."""
    def hash_of(script: str, helper: str) -> str:
        (tmp_path / "beside_it.py").write_text(helper, encoding="utf-8")
        (tmp_path / "the_script.py").write_text(script, encoding="utf-8")
        (tmp_path / "stranger.py").write_text(f"x = {len(seen)}", encoding="utf-8")
        code = ("import sys; sys.path.insert(0, sys.argv[1]); import the_script; "
                "from adaptmg._fingerprint import fingerprint; print(fingerprint(the_script.run).code)")
        answer = subprocess.run([sys.executable, "-B", "-c", code, str(tmp_path)], capture_output=True, text=True,
                                check=True)
        return answer.stdout

    seen: list[str] = []
    script = "from beside_it import double\nLIMIT = 3\ndef run(n):\n    return {'m': double(n) + LIMIT}\n"
    helper = "def double(n):\n    return 2 * n\n"
    seen.append(hash_of(script, helper))
    assert hash_of(script, helper) == seen[0]
    seen.append(hash_of(script, helper.replace("2 * n", "n + n")))
    seen.append(hash_of(script.replace("3", "4"), helper))
    assert len(set(seen)) == 3
