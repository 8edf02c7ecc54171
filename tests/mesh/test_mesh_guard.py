"""Netgen and OCC in a process of their own: errors, crashes, time limits and Ctrl-C end the call
and nothing else."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import psutil
import pytest

import adaptmg as am
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


@pytest.fixture
def in_place_of_netgen(monkeypatch, tmp_path):
    """Let new processes run a code in place of Netgen."""
    script = tmp_path / "python"
    script.touch(mode=0o755)

    @contextmanager
    def run(code):
        script.write_text(f"#!{sys.executable}\nimport os, pickle, sys, time\n{code}\n")
        with netgen(), monkeypatch.context() as patch:  # who asks meanwhile needs another one
            patch.setattr(sys, "executable", str(script))
            yield
            with netgen() as worker:
                worker.end()

    return run


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
    in_place_of_netgen, code, seconds, error, message
):
    with in_place_of_netgen(code), netgen() as worker:
        with pytest.raises(error, match=message):
            worker("hello", seconds=seconds)
        assert not worker.alive
    with netgen() as worker, pytest.raises(NetgenFails, match="KeyError"):
        worker("hello", seconds=60)


def test_limits_are_seconds_of_the_processor_not_of_the_clock(in_place_of_netgen):
    late = "pickle.load(sys.stdin.buffer); time.sleep(1)\npickle.dump((True, 'late'), sys.stdout.buffer)"
    with in_place_of_netgen(late), netgen() as worker:
        assert worker("wait for the disk", seconds=0.3) == "late"


def test_a_mesh_that_fails_is_refused_and_the_next_one_is_made(in_place_of_netgen):
    square = am.Rectangle(width=1, height=1)
    with (
        in_place_of_netgen("os.abort()"),
        pytest.raises(ValueError, match=r"could not mesh Outline.*breaks down.*smaller grading"),
    ):
        am.mesh.graded(square, 0.3, mesher="netgen")
    assert am.mesh.graded(square, 0.3, mesher="netgen").volumes.sum() == pytest.approx(1)


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
