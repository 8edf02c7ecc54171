"""A cluster of the user's own, started as the guide says: ``dask scheduler`` and ``dask worker`` in a shell."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from adaptmg.study import Study

psutil = pytest.importorskip("psutil")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")


@contextlib.contextmanager
def dask(*arguments: str):
    """A command of dask, ended with all it started."""
    started = subprocess.Popen([sys.executable, "-m", "dask", *arguments], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    try:
        yield started
    finally:
        children = psutil.Process(started.pid).children(recursive=True) if started.poll() is None else []
        for process in [*children, started]:
            with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
                process.kill()
        started.wait()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Of a scheduler with two workers of one thread."""
    import json

    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    with dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0",
              "--scheduler-file", str(file)):
        end = time.monotonic() + 120
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        found = json.loads(file.read_text(encoding="utf-8"))["address"]
        with dask("worker", found, "--nthreads", "1", "--nworkers", "2", "--host", "127.0.0.1",
                  "--dashboard-address", "127.0.0.1:0", "--local-directory", str(file.parent)):
            yield found


def test_runs_and_limits(address, tmp_path):
    def run(n):
        if n == 5:
            time.sleep(600)
        time.sleep(0.05)
        return {"m": n * n}

    study = Study(run, {"n": range(12)}, tmp_path / "s.sqlite")
    study.run(progress=False, scheduler=address, limit_s=3)
    table = study.table(details=True)
    assert table["status"].tolist() == ["done"] * 5 + ["failed"] + ["done"] * 6
    assert table["error"][5] == "TimeLimit: stopped after limit_s=3 s" and table["tries"][5] == 1


def test_a_run_that_ends_its_worker(address):
    def run(n):
        if n == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"m": n}

    # as often as dask itself starts it again, and then again alone
    assert Study(run, {"n": range(4)}).run(progress=False, scheduler=address)["error"].tolist() == [
        "", "WorkerDied: worker died 8 times during this run", "", ""]


def test_runs_that_are_given_up_do_not_go_on(address, tmp_path):
    from distributed import Client

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

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=240)  # after the test before
    with pytest.raises(ValueError, match="so"):
        Study(run, {"n": [0, 1]}).run(progress=False, scheduler=address, throw=True)
    given_up = int(Path(mark).read_text(encoding="ascii"))
    end = time.monotonic() + 60
    while psutil.pid_exists(given_up) and time.monotonic() < end:
        time.sleep(0.05)
    assert not psutil.pid_exists(given_up)
    table = Study(lambda n: {"m": n}, {"n": range(6)}).run(progress=False, scheduler=address)
    assert (table["status"] == "done").all()


def test_workers_of_several_threads_are_refused(address):
    from distributed import Client

    with dask("worker", address, "--nthreads", "2", "--no-nanny", "--host", "127.0.0.1",
              "--dashboard-address", "127.0.0.1:0"), Client(address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=120)
        with pytest.raises(ValueError, match=r"has 2 threads.*--nthreads 1"):
            Study(lambda n: {"m": n}, {"n": [1]}).run(progress=False, scheduler=client)


def test_nobody_at_the_address_is_told(monkeypatch):
    from adaptmg.study import cluster as executor

    monkeypatch.setattr(executor, "CONNECT_S", 0.5)
    with pytest.raises(OSError, match=r"nobody answers at tcp:..127\.0\.0\.1:9"):
        Study(lambda n: {"m": n}, {"n": [1]}).run(progress=False, scheduler="tcp://127.0.0.1:9")
