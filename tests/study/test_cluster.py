"""Studies on workers: the same rows as in one process, whatever happens to the workers."""

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from refused import refused

import adaptmg as am
from adaptmg.study import cluster as executor
from adaptmg.study import execute
from adaptmg.study.store import Store, pack

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")

SETTING = 1


@pytest.fixture(scope="module")
def cluster():
    """Two workers, which all tests here share."""
    with am.study.local_cluster(2) as client:
        yield client


def solved(friction, divisions):
    grids = am.Hierarchy.uniform(
        am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(divisions // 2, divisions)
    )
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    return {
        "cycles": result.cycles,
        "residual": result.residual,
        "u": result.displacement,
        "result": result,
        "norm": float(np.linalg.norm(result.displacement)),
    }


def test_results_are_those_of_one_process_bit_by_bit(cluster, tmp_path):
    design = {"friction": [0.2, 1.0], "divisions": [4, 8]}
    serial = am.Study(solved, design, tmp_path / "serial.sqlite")
    spread = am.Study(solved, design, tmp_path / "spread.sqlite")
    one, two = serial.run(progress=False), spread.run(progress=False, scheduler=cluster)
    pd.testing.assert_frame_equal(
        one.drop(columns=["seconds", "result"]),
        two.drop(columns=["seconds", "result"]),
        check_exact=True,
    )
    assert (two["status"] == "done").all()
    for row in range(4):
        assert serial.load(row, "u").tobytes() == spread.load(row, "u").tobytes()
    assert isinstance(spread.load(3, "result"), am.Result)


def test_a_closure_runs_elsewhere_on_one_thread_and_warm(cluster):
    import dask

    factor, here = 3, os.getpid()

    def run(n):
        from adaptmg.study import execute

        return {
            "m": factor * n,
            "here": os.getpid() == here,
            "threads": os.environ["OMP_NUM_THREADS"],
            "numba": os.environ["NUMBA_NUM_THREADS"],
            "warm": bool(execute.warm.cache_info().currsize),
            "problem": am.cases.greco_bar().name,
        }

    table = am.Study(run, {"n": range(7)}).run(progress=False, scheduler=cluster)
    assert table["m"].tolist() == [3 * n for n in range(7)] and table["warm"].all()
    assert not table["here"].any() and set(table["threads"]) == set(table["numba"]) == {"1"}
    folder = cluster.run_on_scheduler(lambda dask_scheduler: dask_scheduler._original_local_dir)
    assert os.path.isdir(folder) and folder.startswith(dask.config.get("temporary-directory"))
    assert set(cluster.run(lambda dask_worker: dask_worker._original_local_dir).values()) == {
        folder
    }


def test_a_run_that_ends_its_worker_once_is_started_again(cluster, tmp_path):
    marks = str(tmp_path)

    def run(n):
        if n == 2 and not os.listdir(marks):
            open(os.path.join(marks, "died"), "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"m": n}

    study = am.Study(run, {"n": range(5)}, tmp_path.parent / f"{tmp_path.name}.sqlite")
    study.run(progress=False, scheduler=cluster)
    table = study.table(details=True)
    assert table["status"].tolist() == ["done"] * 5
    assert table["m"][2] == 2 and len(os.listdir(marks)) == 1


def test_a_run_that_always_ends_its_worker_fails_alone(cluster, tmp_path):
    def run(n):
        if n == 4:  # the last one: dask blames what waits for the same worker, too
            os.kill(os.getpid(), signal.SIGKILL)
        return {"m": n}

    study = am.Study(run, {"n": range(5)}, tmp_path / "s.sqlite")
    study.run(progress=False, scheduler=cluster)
    table = study.table(details=True)
    assert table["status"].tolist() == ["done"] * 4 + ["failed"]
    assert table["error"][4] == "WorkerDied: worker died 2 times during this run"


@pytest.mark.slow
def test_runs_over_their_limits_are_stopped(cluster):
    def run(what):
        if what == "locked":
            ctypes.PyDLL(None).sleep(60)  # keeps Python's lock
        if what == "large":
            kept = [np.ones(2**22) for _ in range(20)]
            time.sleep(60)
            return {"m": len(kept)}
        return {"m": 1}

    timed = am.Study(run, {"what": ["short", "locked"]}).run(
        progress=False, scheduler=cluster, limit_s=4
    )
    assert (
        timed["error"].tolist() == ["", "TimeLimit: stopped after limit_s=4 s"]
        and timed["m"][0] == 1
    )
    held = am.Study(run, {"what": ["short", "large"]}).run(
        progress=False, workers=1, memory_limit=5e8
    )
    assert held["status"].tolist() == ["done", "failed"] and held["error"][1].startswith(
        "MemoryLimit"
    )


def test_errors_come_with_type_text_and_traceback(cluster):
    class OddError(Exception):
        def __init__(self, a, b):
            super().__init__(f"{a} and {b}")

    def run(n):
        raise OddError(n, "more") if n else ValueError("zero")

    study = am.Study(run, {"n": [0, 1]})
    assert study.run(progress=False, scheduler=cluster)["error"].tolist() == [
        "ValueError: zero",
        "OddError: 1 and more",
    ]
    assert "in run" in study.table(details=True)["traceback"][0]
    with pytest.raises(Exception, match=r"zero|more"):
        study.run(progress=False, scheduler=cluster, throw=True)


def test_what_a_worker_lacks_is_reported_immediately(cluster, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def run(n):\n    return {'m': n}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with pytest.raises(RuntimeError, match=r"worker tls.*No module named .only_here"):
        am.Study(only_here.run, {"n": [1]}).run(progress=False, scheduler=cluster)
    monkeypatch.setattr(execute, "identity", lambda: {"numpy": "1.0"})
    with pytest.raises(RuntimeError, match=r"worker tls.*numpy .* instead of 1\.0"):
        am.Study(lambda n: {"m": n}, {"n": [1]}).run(progress=False, scheduler=cluster)


def test_values_set_in_modules_do_not_reach_workers_in_silence(cluster):
    from adaptmg.study import tables

    settings = sys.modules[__name__]

    def run(n):
        return {"m": settings.SETTING * n, "text": tables.as_text.__name__}

    # this module goes by name, and there the value is 1
    study = am.Study(run, {"n": [1]})
    try:
        for value in (2, 1, 3, 1):
            settings.SETTING = value
            if value == 1:
                assert study.run(progress=False, scheduler=cluster)["m"].tolist() == [1]
            else:
                words = r"worker tls.*value of test_cluster.SETTING is changed.*as parameters"
                with pytest.raises(RuntimeError, match=words):
                    study.run(progress=False, scheduler=cluster)
    finally:
        settings.SETTING = 1


def test_a_study_inside_a_run(cluster):
    def run(workers):
        inner = am.Study(lambda n: {"m": n}, {"n": [1, 2]}, name="inner")
        return {"m": int(inner.run(progress=False, workers=workers)["m"].sum())}

    table = am.Study(run, {"workers": [None, 2]}).run(progress=False, scheduler=cluster)
    assert table["m"][0] == 3 and "leave workers= out" in table["error"][1]


def test_studies_can_share_a_cluster_from_several_threads(cluster, tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    def sweep(k):
        def run(n):
            return {"m": k * n}

        return am.Study(run, {"n": range(10)}, tmp_path / "s.sqlite", name=f"s{k}").run(
            progress=False, scheduler=cluster
        )

    with ThreadPoolExecutor(3) as pool:
        tables = list(pool.map(sweep, range(3)))
    assert [table["m"].sum() for table in tables] == [0, 45, 90]


def numbered():
    return am.Study(lambda n: {"m": n}, {"n": [1]})


test_wrong_clusters_are_refused = refused(
    (lambda: numbered().run(workers=1, scheduler="tcp://127.0.0.1:1"), "not both"),
    (lambda: numbered().run(workers=0), "workers must be >= 1"),
    (lambda: numbered().run(limit_s=1.0), "need workers"),
    (lambda: numbered().run(scheduler=3), TypeError, "scheduler must be"),
    *(
        (lambda address=address: numbered().run(scheduler=address), "must be an address")
        for address in ("", "tcp://", "host", "tcp://host: 8786")
    ),
)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr(executor, "CONNECT_S", 0.5)
    with pytest.raises(OSError, match=r"nobody answers at tcp:..127\.0\.0\.1:9"):
        numbered().run(scheduler="tcp://127.0.0.1:9")


SCRIPT = """
    import ctypes, os, subprocess, sys
    import numpy as np
    from adaptmg.study import Study

    def run(number):
        if number >= int(os.environ["ENDING_RUNS"]):
            subprocess.Popen(["sleep", "600"])
            ctypes.PyDLL(None).sleep(600)  # keeps Python's lock, as compiled code may
        return {"u": np.random.default_rng(number).normal(size=100)}

    study = Study(run, {"number": range(3)}, sys.argv[1])
    study.run(workers=None if os.environ["ENDING_RUNS"] == "3" else 2, progress=False)
"""


@pytest.mark.slow
def test_a_study_that_is_ended_keeps_rows_and_no_process_and_goes_on(tmp_path):
    """A script without a guard for ``__main__``, whose runs start processes and cannot be
    interrupted: by Ctrl-C, then by the system."""
    script, path = tmp_path / "script.py", tmp_path / "s.sqlite"
    script.write_text(textwrap.dedent(SCRIPT), encoding="utf-8")

    def started(ending):
        return subprocess.Popen(
            [sys.executable, str(script), str(path)],
            stderr=subprocess.DEVNULL,
            env=os.environ | {"ENDING_RUNS": str(ending)},
        )

    def rows():
        return Store(path).get("run") if path.exists() else {}

    for ending, how in ((1, signal.SIGINT), (2, signal.SIGKILL)):
        study = started(ending)
        processes = []
        end = time.monotonic() + 240
        while time.monotonic() < end and (
            len(rows()) < ending
            or [process.name() for process in processes].count("sleep") < 3 - ending
        ):
            time.sleep(0.5)
            processes = psutil.Process(study.pid).children(recursive=True)
        study.send_signal(how)
        assert study.wait(60) != 0
        assert not psutil.wait_procs(processes, timeout=30)[1]
        assert len(rows()) == ending
    assert started(3).wait(120) == 0
    assert len(rows()) == 3
    for key, record in rows().items():
        u = np.random.default_rng(record.parameters["number"]).normal(size=100)
        assert record.status == "done" and Store(path).kept("run", key) == {"u": pack(u)}


# a cluster of the user, started as the README says: ``dask scheduler`` and ``dask worker`` in a
# shell


@contextlib.contextmanager
def dask(*arguments: str):
    """Run a command of dask, and end it with all processes that it started; dask itself starts a run
    that ended its worker again."""
    started = subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"},
    )
    try:
        yield started
    finally:
        children = (
            psutil.Process(started.pid).children(recursive=True) if started.poll() is None else []
        )
        for process in [*children, started]:
            with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
                process.kill()
        started.wait()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Of a scheduler with two workers of one thread."""
    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    with dask(
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--dashboard-address",
        "127.0.0.1:0",
        "--scheduler-file",
        str(file),
    ):
        end = time.monotonic() + 120
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        found = json.loads(file.read_text(encoding="utf-8"))["address"]
        with dask(
            "worker",
            found,
            "--nthreads",
            "1",
            "--nworkers",
            "2",
            "--host",
            "127.0.0.1",
            "--dashboard-address",
            "127.0.0.1:0",
            "--local-directory",
            str(file.parent),
        ):
            yield found


def test_runs_that_are_given_up_do_not_go_on(address, tmp_path):
    mark = str(tmp_path / "pid")

    def run(n):
        if n:
            with open(f"{mark}.part", "w", encoding="ascii") as file:
                file.write(str(os.getpid()))
            os.rename(f"{mark}.part", mark)
            time.sleep(600)
        end = time.monotonic() + 240
        while not os.path.exists(mark) and time.monotonic() < end:
            time.sleep(0.05)
        raise ValueError("so")

    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=240)
    with pytest.raises(ValueError, match="so"):
        am.Study(run, {"n": [0, 1]}).run(progress=False, scheduler=address, throw=True)
    given_up = int(Path(mark).read_text(encoding="ascii"))
    end = time.monotonic() + 60
    while psutil.pid_exists(given_up) and time.monotonic() < end:
        time.sleep(0.05)
    assert not psutil.pid_exists(given_up)
    table = am.Study(lambda n: {"m": n}, {"n": range(6)}).run(progress=False, scheduler=address)
    assert (table["status"] == "done").all()


# what a cluster rarely does


def _client(workers=None, **given):
    return SimpleNamespace(
        scheduler=SimpleNamespace(address="tcp://s"),
        wait_for_workers=lambda n, timeout: None,
        scheduler_info=lambda n_workers: {"workers": workers or {}},
        **given,
    )


@pytest.mark.parametrize(
    ("threads", "words"), [(1, "has no nanny"), (2, r"has 2 threads.*--nthreads 1")]
)
def test_workers_without_a_nanny_and_of_several_threads_are_refused(threads, words):
    """A nanny restarts a worker whose run is over its limit."""
    client = _client({"tcp://w": {"nthreads": threads, "nanny": None}})
    with pytest.raises(ValueError, match=words):
        executor.check_workers(client, None, limited=True)


def test_a_worker_that_leaves_during_the_check_is_not_unfit():
    found = {"tcp://w": distributed.comm.CommClosedError("reset by peer"), "tcp://v": None}
    client = _client(run=lambda *a, **k: found)
    executor.check_workers(client, None, limited=False)
    found["tcp://v"] = ModuleNotFoundError("No module named 'adaptmg'")
    with pytest.raises(
        RuntimeError,
        match="tcp://v cannot compute this study: ModuleNotFoundError: No module named",
    ):
        executor.check_workers(client, None, limited=False)


def _children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


@pytest.mark.parametrize(
    "owner, name, value",
    [(sys, "executable", shutil.which("false")), (executor, "PATIENCE_S", 0.0)],
    ids=["ended", "too slow"],
)
def test_failed_starts_leave_no_process(monkeypatch, owner, name, value):
    before = _children()
    monkeypatch.setattr(owner, name, value)
    with (
        pytest.raises(OSError, match=r"2 processes could not be started .*fewer workers"),
        am.study.local_cluster(2),
    ):
        pass
    assert _children() <= before


@pytest.mark.slow
def test_a_process_that_is_killed_while_all_start_is_replaced():
    """By a system that is short of memory, say. Ctrl-C then leaves no process."""
    killed = []

    def kill():
        end = time.monotonic() + 30
        while not killed and time.monotonic() < end:
            time.sleep(0.1)
            for process in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    if process.pid not in before and "spawn_main" in " ".join(process.cmdline()):
                        process.kill()
                        killed.append(process.pid)
                        break

    before = _children()
    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(KeyboardInterrupt), am.study.local_cluster(1) as client:
        assert len(killed) == 1 and client.submit(os.getpid).result() not in killed
        raise KeyboardInterrupt
    killer.join()
    assert _children() <= before


def test_others_cannot_compute_in_the_processes(cluster):
    ours = _children()
    listening = [one for one in psutil.net_connections("tcp") if one.status == psutil.CONN_LISTEN]
    ports = [one.laddr for one in listening if one.pid in ours]
    assert len(ports) >= 4 and {port.ip for port in ports} == {"127.0.0.1"}
    address = cluster.scheduler.address
    assert address.startswith("tls://")
    port = cluster.run_on_scheduler(lambda dask_scheduler: dask_scheduler.http_server.port)
    for page in ("", "status", "health", "metrics", "info/main/workers.html", "json/counts.json"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}")
    workers = [
        worker["nanny"] for worker in cluster.scheduler_info(n_workers=-1)["workers"].values()
    ]
    for other, security in (
        (address, distributed.Security.temporary()),
        (address.replace("tls", "tcp"), None),
        (workers[0].replace("tls", "tcp"), None),
    ):
        with pytest.raises((OSError, TimeoutError)):
            distributed.Client(other, security=security, set_as_default=False, timeout=1)


def _runs(client=None, limit_s=None, **out):
    order = executor.Order(b"", {}, None, ())
    runs = executor._Runs(client, order, iter(()), limit_s)
    runs._out.update(out)
    return runs


def test_the_death_of_a_worker_is_not_a_time_limit():
    """Whenever it is reported: only a run that this process stopped is over its limit."""
    runs = _runs(limit_s=3.0, run=executor._Run({"n": 6}, time.monotonic() - 60.0, None))
    assert runs._outcome("run", executor.KilledWorker("run", None, 0)).record.error.startswith(
        "WorkerDied"
    )


@pytest.mark.parametrize("local", [True, False])
def test_a_study_waits_for_a_queue_not_for_dead_processes(local, monkeypatch, caplog):
    from distributed.core import Status

    monkeypatch.setattr(executor, "PATIENCE_S", 0.02)
    processes = object.__new__(executor.LocalCluster)
    processes.status = Status.closed  # it cannot be closed
    runs = _runs(
        SimpleNamespace(
            cluster=processes if local else None,
            nthreads=dict,
            scheduler=SimpleNamespace(address="tcp://s"),
        )
    )
    assert runs._slots() == 1
    time.sleep(0.03)
    if local:
        with pytest.raises(OSError, match="does not start them again"):
            runs._slots()
    else:
        assert runs._slots() == 1
    assert "has no workers: 0 runs wait" in caplog.text


@pytest.mark.parametrize("there", [True, False], ids=["it computes", "its worker died"])
def test_a_clock_stops_only_a_run_that_its_worker_computes(there):
    client = SimpleNamespace(
        processing=lambda: {"tcp://a": ("late",) if there else ()},
        cancel=lambda *a, **k: None,
        run=lambda *a, **k: None,
    )
    run = executor._Run(
        {"n": 6}, 0.0, SimpleNamespace(done=lambda: False), worker="tcp://a", began=0.0
    )
    runs = _runs(client, 1.0, late=run)
    runs._stop_late()
    assert runs._back.empty() is not there
