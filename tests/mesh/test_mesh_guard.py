"""Netgen and OCC in a process of their own: errors, crashes, time limits and Ctrl-C end the call
and nothing else."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest

import adaptmg as am
from adaptmg.mesh import netgen_guard
from adaptmg.mesh.netgen_guard import NetgenFails, NetgenUnfinished, netgen


def test_one_process_serves_all_calls_and_errors_keep_it():
    with netgen() as first:
        with pytest.raises(NetgenFails):
            first("read_vol", "nowhere.vol", seconds=20)
        assert first.alive
    with netgen() as again, netgen() as other:
        assert again is first and other is not first
    # one of them is enough
    assert first.alive != other.alive


@pytest.mark.parametrize(
    ("code", "seconds", "error", "message"),
    [
        ("os.abort()", 60, NetgenFails, "it breaks down, exit code -6"),
        ("while True: pass", 1, NetgenUnfinished, "it does not finish within 1 s of the processor"),
        (
            "time.sleep(60)",
            0.1,
            NetgenUnfinished,
            "it does not finish within 0.1 s of the processor",
        ),
    ],
)
def test_a_process_that_breaks_down_or_hangs_is_replaced(
    monkeypatch, tmp_path, code, seconds, error, message
):
    monkeypatch.setattr(netgen_guard, "_idle", {})
    with monkeypatch.context() as patch:
        patch.setattr(netgen_guard, "_WORKER", tmp_path / "worker.py")
        (tmp_path / "worker.py").write_text(f"import os, time\n{code}\n")
        with pytest.raises(error, match=message), netgen() as worker:
            worker("hello", seconds=seconds)
    assert not worker.alive and not netgen_guard._idle[os.getpid()]
    with netgen() as worker, pytest.raises(NetgenFails, match="KeyError"):
        worker("hello", seconds=60)
    worker.end()


def test_limits_are_seconds_of_the_processor_not_of_the_clock(monkeypatch, tmp_path):
    monkeypatch.setattr(netgen_guard, "_idle", {})
    monkeypatch.setattr(netgen_guard, "_WORKER", tmp_path / "worker.py")
    (tmp_path / "worker.py").write_text(
        "import pickle, sys, time\npickle.load(sys.stdin.buffer)\ntime.sleep(1)\n"
        "pickle.dump((True, 'late'), sys.stdout.buffer)\n"
    )
    with netgen() as worker:
        assert worker("wait for the disk", seconds=0.3) == "late"


def test_a_mesh_that_does_not_finish_is_refused_with_the_limit(monkeypatch):
    strip = am.Rectangle(width=1, height=1e-3)
    assert am.mesh.graded(strip, 0.3).volumes.sum() == pytest.approx(1e-3)
    monkeypatch.setattr(netgen_guard, "LIMIT_S", {2: 1.0, 3: 1.0})
    with pytest.raises(
        ValueError,
        match=r"could not mesh Outline.*does not finish within 1 s of the processor: take smaller sizes",
    ):
        am.mesh.graded(am.Rectangle(width=1, height=1e-5), 0.2, mesher="netgen")
    monkeypatch.undo()
    assert am.mesh.graded(strip, 0.3).volumes.sum() == pytest.approx(1e-3)


def test_threads_and_size_functions_mesh_in_their_own_processes():
    square = am.Rectangle(width=1, height=1)

    def mesh(_):
        return am.mesh.sized(
            square, lambda x: np.full(len(x), 0.1 * am.mesh.graded(square, 0.5).volumes.sum()), 0.3
        )

    alone = mesh(0)
    with ThreadPoolExecutor(2) as pool:
        for other in pool.map(mesh, range(2)):
            np.testing.assert_array_equal(alone.points, other.points)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_and_kill_end_both_processes(how):
    # in a shell's background the signal comes ignored; the mesh has a million nodes
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import adaptmg as am; from adaptmg.mesh import graded, netgen_guard\n"
        "with netgen_guard.netgen() as worker: print(worker.process.pid, flush=True)\n"
        "print(graded(am.Box(width=1, depth=1, height=1), 0.012, mesher='netgen').n_nodes)\n"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as child:
        try:
            pid = int(child.stdout.readline())
            time.sleep(0.5)
            assert child.poll() is None
            os.kill(child.pid, how)
            done, error = child.communicate(timeout=60)
        finally:
            child.kill()  # or the end of this block would wait for it
        assert (
            not done
            and child.returncode == -how
            and ("KeyboardInterrupt" in error) == (how == signal.SIGINT)
        )
    end = time.monotonic() + 60
    while time.monotonic() < end and _runs(pid):
        time.sleep(0.1)
    assert not _runs(pid)


def _runs(pid):
    # nobody waits for orphans in some containers
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
