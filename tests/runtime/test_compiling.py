"""The second process of a first solve: what it compiles, when it starts and that it ends.

``python tests/runtime/test_compiling.py`` writes the list of kernels again.
"""

import os
import subprocess
import sys
import time

import numba
import numpy as np
import pytest

from adaptmg import _ahead
from adaptmg.mesh import improve

#: the README's ten lines; prints each kernel when it is first called
FIRST_SOLVE = '''
import adaptmg as am
from numba.core.registry import CPUDispatcher
from adaptmg import _ahead
called = CPUDispatcher._compile_for_args

def noted(self, *arguments):
    signature = tuple(map(self.typeof_pyval, arguments))
    print(self.py_func.__module__, self.py_func.__qualname__, _ahead.encoded(signature))
    return called(self, *arguments)

CPUDispatcher._compile_for_args = noted
problem = am.cases.greco_bar(law=am.Coulomb(1.0))
grids = am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
result = am.solve(grids)
result.certificate()
result.probe([(0.0, 0.0), (0.005, 0.0)])
'''


def _kernels_of_a_first_solve() -> str:
    return subprocess.run([sys.executable, "-c", FIRST_SOLVE], capture_output=True, text=True, check=True).stdout


def test_the_list_is_what_the_first_solve_compiles_in_its_order():
    assert _ahead.LIST.read_text() == _kernels_of_a_first_solve(), f"run python {__file__}"


def test_signatures_are_read_back():
    arrays = [np.zeros((2, 3)), np.zeros(4, dtype=np.int32), np.zeros(4, dtype=bool)]
    arrays[1].flags.writeable = False
    signature = tuple(numba.typeof(x) for x in (*arrays, 1, 2.0, True, (1.0, 2.0), ()))
    assert _ahead.encoded(signature) == "float64.2C int32.1Cr bool.1C int64 float64 bool float64*2 float64*0"
    assert _ahead.decoded(_ahead.encoded(signature)) == signature


@pytest.fixture
def children(monkeypatch):
    """The commands of the processes that a miss in the cache starts on two free cores outside of tests."""
    started = []
    monkeypatch.setattr(_ahead.subprocess, "Popen", lambda command, **_: started.append(command))
    monkeypatch.setattr(_ahead.atexit, "register", lambda *_: None)
    monkeypatch.setattr(_ahead, "_one_of_many", lambda: False)
    monkeypatch.setattr(_ahead, "_running", lambda: 1)
    monkeypatch.setattr(_ahead.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    _ahead._start.cache_clear()
    yield started
    _ahead._start.cache_clear()


def test_a_listed_kernel_starts_one_process_where_a_core_is_free(children, monkeypatch):
    _ahead.start(test_signatures_are_read_back)
    assert children == []
    _ahead.start(improve._swap.py_func)
    _ahead.start(improve._across.py_func)
    assert len(children) == 1
    for where, name, value in ((_ahead, "_one_of_many", lambda: True), (_ahead, "_running", lambda: 2),
                               (numba.config, "NUMBA_NUM_THREADS", 1)):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, value)
            _ahead._start.cache_clear()
            _ahead.start(improve._swap.py_func)
    assert len(children) == 1


def test_tests_start_none():
    assert _ahead._one_of_many()


@pytest.mark.parametrize("ended", ["input closed", "parent gone"])
def test_the_process_compiles_into_the_cache_without_a_word_and_ends_with_its_parent(ended, tmp_path):
    parent = os.getpid() if ended == "input closed" else 0
    child = subprocess.Popen([sys.executable, "-c", f"from adaptmg import _ahead; _ahead.compile_all({parent})"],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                             env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)})
    if parent:
        until = time.monotonic() + 60.0
        while not list(tmp_path.rglob("*.nbc")) and time.monotonic() < until:
            time.sleep(0.05)
        assert list(tmp_path.rglob("*.nbc"))
        child.stdin.close()
    assert child.wait(timeout=30.0) == 0
    assert child.stdout.read() == b""
    child.stdin.close()
    child.stdout.close()


if __name__ == "__main__":
    _ahead.LIST.write_text(_kernels_of_a_first_solve())
