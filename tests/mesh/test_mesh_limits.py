"""Netgen and OCC are asked beforehand whether they can, in a process of their own, and can be interrupted."""

import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from netgen.occ import Box as OccBox
from netgen.occ import Pnt

import adaptmg as am
from adaptmg.mesh import graded, refine_near, step_names, structured
from adaptmg.mesh import netgen_guard as step_check
from adaptmg.mesh.netgen_guard import NetgenBusy, NetgenEndless, _abandoned, curved_nodes, interruptible, thickness


def outline(*vertices):
    return am.Polygon(vertices=vertices, boundaries=tuple("abcdefgh"[:len(vertices)]))


@pytest.mark.parametrize(("polygon", "value"), [
    (outline((0, 0), (1, 0), (1, 0.25), (0, 0.25)), 0.25),
    (outline((0, 0), (1, 0), (1, 1e-3)), 1e-3),
    (outline((0, 0), (.5, 0), (.5, .5), (.51, .5), (.51, 0), (1, 0), (1, 1), (0, 1)), 0.01),
    (outline((0, 0), (1, 0), (1, 1), (1e-5, 1), (0, 1 - 1e-5)), 1.0),  # a chamfer is short, not thin
])
def test_thickness(polygon, value):
    assert thickness(polygon) == pytest.approx(value, rel=1e-3)


def test_thin_domains_need_small_sizes():
    strip = am.Rectangle(width=1, height=1e-3)
    assert graded(strip, 0.3).volumes.sum() == pytest.approx(1e-3)
    with pytest.raises(ValueError, match=r"size: edges of 0.6 m are more than 500 times .* ask for at most 0.5 m"):
        graded(strip, 0.6)
    # what counts is the size along the thin part
    assert graded(am.Rectangle(width=1, height=1e-4), 1e-3).volumes.sum() == pytest.approx(1e-4)


def test_round_faces_are_counted():
    wire = am.Cylinder((0, 0, 0), (0, 0, 1), 1e-3, 1)
    assert curved_nodes(wire, 0.3, 2) == pytest.approx(0.5 * 1.15 * 2 * np.pi * 1e-3 / (5e-4) ** 2)
    assert curved_nodes(am.Cut(am.Box(width=1, depth=1, height=1), wire), 0.3, 2) == curved_nodes(wire, 0.3, 2)
    assert curved_nodes(wire, 1e-4, 2) == 0


@pytest.mark.parametrize("levels", [25, 60, 10**6])
def test_bisections_beyond_the_limit(levels):
    mesh = structured(am.Rectangle(width=1, height=1), 2)
    with pytest.raises(ValueError, match=f"levels: {levels} bisections along 2 facets of top ask for about"):
        refine_near(mesh, "top", levels)


def test_what_bisection_leaves_is_printed_and_warned_of():
    problem = am.cases.greco_bar()
    coarsest = structured(problem.domain, 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        few = repr(am.Hierarchy.bisected(problem, coarsest, 1))
        am.Hierarchy.bisected(problem, coarsest, 2)
    with pytest.warns(UserWarning, match=r"levels=4: .*elements of up to 0.00707 m.*hardly help.*fewer levels") as said:
        many = repr(am.Hierarchy.bisected(problem, coarsest, 4))
    assert said[0].filename == __file__
    assert "limits: only elements at contact are refined (to 0.00354 m); away from it 84 % of the domain keeps " in few
    assert "more levels hardly help" in many and "hardly" not in few
    assert "limits" not in repr(am.Hierarchy.uniform(problem, (2, 4)))


def test_a_call_returns_and_raises_as_without_a_thread():
    assert interruptible(max, 3, 4) == 4
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 / 0)
    before = threading.stack_size()
    interruptible(time.sleep, 0)
    assert threading.stack_size() == before


def test_a_call_that_comes_to_no_end():
    end = threading.Event()
    with pytest.raises(NetgenEndless, match="no end in 0 s"):
        interruptible(end.wait, limit=0.3)
    with pytest.raises(NetgenBusy, match="still at work"):
        interruptible(abs, -1)
    end.set()
    _abandoned[0].wait()
    assert interruptible(abs, -1) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_is_heard():
    # in a shell's background the signal comes ignored
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); " \
           "import adaptmg as am; from adaptmg.mesh import graded; print('go', flush=True); " \
           "graded(am.Box(width=1, depth=1, height=1), 0.012)"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as child:
        try:
            assert child.stdout.readline() == "go\n"
            time.sleep(2.5)
            assert child.poll() is None  # this mesh takes minutes
            os.kill(child.pid, signal.SIGINT)
            _, error = child.communicate(timeout=60)
        finally:
            child.kill()  # or the end of this block would wait for it
        assert "KeyboardInterrupt" in error
        assert child.returncode == -signal.SIGINT  # not a crash while Netgen is still at work


def test_step_files_are_tried_once(tmp_path, monkeypatch):
    calls = []
    real = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: calls.append(a) or real(*a, **k))
    OccBox(Pnt(0, 0, 0), Pnt(1, 2, 3.25)).WriteStep(str(tmp_path / "a.step"))
    step_check._known.clear()
    (tmp_path / "b.step").write_bytes((tmp_path / "a.step").read_bytes())
    for name in ("a.step", "a.step", "b.step"):
        assert list(step_names(tmp_path / name)) == ["solid1"]
    assert len(calls) == 1


@pytest.mark.parametrize(("code", "message", "limit"), [
    ("import os; os.abort()", "OCC breaks down on it", 60),
    ("import sys; print('solid 1 has no size', file=sys.stderr); sys.exit(3)", "solid 1 has no size", 60),
    ("import time; time.sleep(60)", "OCC comes to no end", 1),
])
def test_a_child_that_ends_or_hangs_is_an_error_with_the_file(tmp_path, monkeypatch, code, message, limit):
    monkeypatch.setattr(step_check, "_CHILD", code)
    monkeypatch.setattr(step_check, "_START_S", limit)
    step_check._known.clear()
    (tmp_path / "bad.step").write_text("ISO-10303-21;")
    for _ in range(2):
        with pytest.raises(ValueError, match=f"bad.step.* cannot be read as a STEP file: {message}"):
            step_names(tmp_path / "bad.step")
    step_check._known.clear()
