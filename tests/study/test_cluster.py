"""Studies on workers: the same rows as in one process, whatever happens to the workers."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pandas as pd
import pytest

import adaptmg as am
from adaptmg.study import Study, local_cluster

distributed = pytest.importorskip("distributed")

SETTING = 1


@pytest.fixture(scope="module")
def cluster():
    """Two workers, which all tests here share."""
    with local_cluster(2) as client:
        yield client


def solved(friction, divisions):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(divisions // 2, divisions))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    return {"cycles": result.cycles, "residual": result.residual, "u": result.displacement, "result": result,
            "norm": float(np.linalg.norm(result.displacement))}


def test_results_are_those_of_one_process_bit_by_bit(cluster, tmp_path):
    design = {"friction": [0.2, 1.0], "divisions": [4, 8]}
    serial = Study(solved, design, tmp_path / "serial.sqlite")
    spread = Study(solved, design, tmp_path / "spread.sqlite")
    one, two = serial.run(progress=False), spread.run(progress=False, scheduler=cluster)
    pd.testing.assert_frame_equal(one.drop(columns=["seconds", "result"]), two.drop(columns=["seconds", "result"]),
                                  check_exact=True)
    assert (two["status"] == "done").all()
    for row in range(4):
        assert serial.load(row, "u").tobytes() == spread.load(row, "u").tobytes()
    assert isinstance(spread.load(3, "result"), am.Result)


def test_a_closure_runs_in_other_processes_with_one_thread(cluster):
    factor, here = 3, os.getpid()

    def run(n):
        return {"m": factor * n, "here": os.getpid() == here, "threads": os.environ["OMP_NUM_THREADS"],
                "numba": os.environ["NUMBA_NUM_THREADS"]}

    table = Study(run, {"n": range(7)}).run(progress=False, scheduler=cluster)
    assert table["m"].tolist() == [3 * n for n in range(7)]
    assert not table["here"].any() and set(table["threads"]) == set(table["numba"]) == {"1"}


def test_a_worker_that_dies_is_survived(cluster, tmp_path):
    marks = str(tmp_path)

    def run(n):
        tried = len(os.listdir(marks))
        if n == 1 or (n == 2 and tried < 1):
            if n == 2:
                open(os.path.join(marks, f"{tried}"), "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"m": n}

    study = Study(run, {"n": range(5)}, tmp_path.parent / f"{tmp_path.name}.sqlite")
    study.run(progress=False, scheduler=cluster)
    table = study.table(details=True)
    assert table["status"].tolist() == ["done", "failed", "done", "done", "done"]
    assert table["error"][1] == "WorkerDied: worker died 3 times during this run" and table["tries"][1] == 3
    assert table["tries"][2] >= 2 and table["m"][2] == 2


def test_runs_over_their_limits_are_stopped(cluster):
    def run(what):
        if what == "long":
            time.sleep(60)
        if what == "large":
            kept = [np.ones(2**22) for _ in range(40)]
            time.sleep(60)
            return {"m": len(kept)}
        return {"m": 1}

    timed = Study(run, {"what": ["short", "long"]}).run(progress=False, scheduler=cluster, limit_s=1)
    assert timed["error"].tolist() == ["", "TimeLimit: stopped after limit_s=1 s"] and timed["m"][0] == 1
    held = Study(run, {"what": ["short", "large"]}).run(progress=False, scheduler=cluster, memory_limit=1e9)
    assert held["status"].tolist() == ["done", "failed"] and held["error"][1].startswith("MemoryLimit")


def test_code_that_holds_the_lock_of_python_is_stopped_too(cluster):
    def run(n):
        if n:
            ctypes.PyDLL(None).sleep(60)
        return {"m": n}

    table = Study(run, {"n": [0, 1]}).run(progress=False, scheduler=cluster, limit_s=1)
    assert table["error"].tolist() == ["", "TimeLimit: stopped after limit_s=1 s"]


@pytest.mark.parametrize("when", ["before", "while it runs"])
def test_processes_that_dask_gave_up_are_started_anew(when, monkeypatch, caplog):
    """As on a machine that is so busy that they are slow to start."""
    import dask

    from adaptmg.study import cluster as executor
    from adaptmg.study import cluster as fitness
    from adaptmg.study.cluster import local_cluster

    def run(n):
        return {"m": n, "here": os.getpid()}

    with local_cluster(1) as client:
        assert dask.config.get("distributed.deploy.lost-worker-timeout") == "1h"
        monkeypatch.setattr(executor, "_PATIENCE_S", 2.0)
        monkeypatch.setattr(fitness, "PATIENCE_S", 2.0)
        monkeypatch.setattr(fitness, "_TRIES", 50)
        study = Study(run, {"n": range(3)})
        first = study.run(progress=False, scheduler=client)

        def give_up():
            client.cluster.sync(client.cluster.workers[0].close)

        if when == "before":
            give_up()
        else:
            monkeypatch.setattr(executor, "check_workers", lambda *_: give_up())
        again = study.run(progress=False, scheduler=client, rerun=True)
    assert again["m"].tolist() == [0, 1, 2] and set(again["here"]).isdisjoint(first["here"])
    assert "no process that computes runs is left: starting 1" in caplog.text


def test_scratch_files_of_dask_lie_in_a_folder_that_goes(cluster):
    import dask

    folder = cluster.run_on_scheduler(lambda dask_scheduler: dask_scheduler._original_local_dir)
    assert os.path.isdir(folder) and folder.startswith(dask.config.get("temporary-directory"))
    assert set(cluster.run(lambda dask_worker: dask_worker._original_local_dir).values()) == {folder}


def test_kernels_are_warm_before_a_clock_starts(cluster):
    def run(n):
        from adaptmg.study import in_worker

        return {"warm": in_worker._warmed, "problem": am.cases.greco_bar().name}

    assert Study(run, {"n": range(2)}).run(progress=False, scheduler=cluster)["warm"].tolist() == [True, True]


def test_errors_come_with_type_text_and_traceback(cluster):
    class OddError(Exception):
        def __init__(self, a, b):
            super().__init__(f"{a} and {b}")

    def run(n):
        raise OddError(n, "more") if n else ValueError("zero")

    study = Study(run, {"n": [0, 1]})
    assert study.run(progress=False, scheduler=cluster)["error"].tolist() == ["ValueError: zero",
                                                                              "OddError: 1 and more"]
    assert "in run" in study.table(details=True)["traceback"][0]
    with pytest.raises(Exception, match=r"zero|more"):
        study.run(progress=False, scheduler=cluster, throw=True)


def test_what_a_worker_lacks_is_told_at_once(cluster, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def run(n):\n    return {'m': n}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with pytest.raises(RuntimeError, match=r"worker tcp.*no module 'only_here'"):
        Study(only_here.run, {"n": [1]}).run(progress=False, scheduler=cluster)


def test_another_adaptmg_on_a_worker_is_told_at_once(cluster, monkeypatch):
    from adaptmg.study import cluster as executor

    monkeypatch.setattr(executor, "identity", lambda: {"numpy": "1.0"})
    with pytest.raises(RuntimeError, match=r"worker tcp.*numpy .* instead of 1\.0"):
        Study(lambda n: {"m": n}, {"n": [1]}).run(progress=False, scheduler=cluster)


def test_a_value_that_was_set_in_a_module_does_not_reach_workers_in_silence(cluster, monkeypatch):
    from adaptmg.study import tables

    settings = sys.modules[__name__]
    monkeypatch.setattr(settings, "SETTING", 2)

    def run(n):
        return {"m": settings.SETTING * n, "text": tables.as_text.__name__}

    # this module goes by name, and there the value is another one
    with pytest.raises(RuntimeError, match=r"worker tcp.*value of test_cluster.SETTING is changed.*as parameters"):
        Study(run, {"n": [1]}).run(progress=False, scheduler=cluster)
    monkeypatch.setattr(settings, "SETTING", 1)
    study = Study(run, {"n": [1]})
    assert study.run(progress=False, scheduler=cluster)["m"].tolist() == [1]
    monkeypatch.setattr(settings, "SETTING", 3)
    with pytest.raises(RuntimeError, match=r"SETTING is changed"):
        study.run(progress=False, scheduler=cluster)


def test_a_study_inside_a_run(cluster):
    def run(workers):
        inner = Study(lambda n: {"m": n}, {"n": [1, 2]}, name="inner")
        return {"m": int(inner.run(progress=False, workers=workers)["m"].sum())}

    table = Study(run, {"workers": [None, 2]}).run(progress=False, scheduler=cluster)
    assert table["m"][0] == 3 and "leave workers= out" in table["error"][1]


def test_studies_can_share_a_cluster_from_several_threads(cluster, tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    def sweep(k):
        def run(n):
            return {"m": k * n}

        return Study(run, {"n": range(10)}, tmp_path / "s.sqlite", name=f"s{k}").run(progress=False, scheduler=cluster)

    with ThreadPoolExecutor(3) as pool:
        tables = list(pool.map(sweep, range(3)))
    assert [table["m"].sum() for table in tables] == [0, 45, 90]


def test_wrong_clusters_are_refused():
    study = Study(lambda n: {"m": n}, {"n": [1]})
    with pytest.raises(ValueError, match="not both"):
        study.run(workers=1, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ValueError, match="workers must be >= 1"):
        study.run(workers=0)
    with pytest.raises(ValueError, match="need workers"):
        study.run(limit_s=1.0)
    with pytest.raises(TypeError, match="scheduler must be"):
        study.run(scheduler=3)
    for address in ("", "tcp://", "host", "tcp://host: 8786"):
        with pytest.raises(ValueError, match="scheduler must be an address"):
            study.run(scheduler=address)


SCRIPT = """
    import ctypes, functools, sys, time
    from adaptmg.study import Study

    @functools.lru_cache
    def square(n):
        return n * n

    hang = sys.argv[2:] == ["--hang"]

    def hanging(n):
        if n >= 10 and hang:
            ctypes.PyDLL(None).sleep(600)  # keeps Python's lock
        return {"square": square(n)}

    study = Study(hanging, {"n": range(12)}, sys.argv[1], depends={"hang": None})
    print(study.run(workers=2, progress=False)["square"].tolist())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGKILL])
def test_a_script_that_is_ended_keeps_what_is_done_and_leaves_nothing(tmp_path, kind):
    """A script without a guard for ``__main__``, whose runs cannot be interrupted, and then again."""
    psutil = pytest.importorskip("psutil")
    from adaptmg.study.store import Store

    script, path = tmp_path / "script.py", tmp_path / "s.sqlite"
    script.write_text(textwrap.dedent(SCRIPT), encoding="utf-8")
    started = subprocess.Popen([sys.executable, str(script), str(path), "--hang"], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    end = time.monotonic() + 240
    while time.monotonic() < end and (not path.exists() or len(Store(path).get("hanging")) < 5):
        time.sleep(0.2)
    processes = psutil.Process(started.pid).children(recursive=True)
    assert len(processes) >= 2
    started.send_signal(kind)
    started.wait(60)
    assert not psutil.wait_procs(processes, timeout=60)[1]
    if kind == signal.SIGKILL:
        again = subprocess.run([sys.executable, str(script), str(path)], capture_output=True, text=True)
        assert again.stdout == f"{[n * n for n in range(12)]}\n", again.stderr
    assert len(Store(path).get("hanging")) >= (12 if kind == signal.SIGKILL else 5)


def test_the_serial_way_does_not_load_dask():
    # pandas itself loads cloudpickle where pyarrow is installed
    code = ("import sys, pandas\nbefore = set(sys.modules)\nfrom adaptmg.study import Study\n"
            "Study(lambda n: {'m': n}, {'n': [1, 2]}).run()\n"
            "sys.exit(bool({'dask', 'distributed', 'cloudpickle'} & (set(sys.modules) - before)))")
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
