"""The second process of a first solve: what it compiles, when it starts and that it ends. What kernels share."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from adaptmg import _ahead
from adaptmg._runtime import _Flags, _Linked, inner_kernel, kernel
from adaptmg.mesh import improve

FIRST_SOLVE = Path(__file__).parents[1] / "helpers" / "first_solve.py"


def test_the_list_is_what_the_first_solve_calls_in_its_order():
    done = subprocess.run([sys.executable, str(FIRST_SOLVE)], capture_output=True, text=True, check=True)
    assert _ahead.LIST.read_text() == done.stdout, f"run python {FIRST_SOLVE} > {_ahead.LIST}"


def test_signatures_are_read_back():
    arrays = [np.zeros((2, 3)), np.zeros(4, dtype=np.int32), np.zeros(4, dtype=bool)]
    arrays[1].flags.writeable = False
    signature = tuple(numba.typeof(x) for x in (*arrays, 1, 2.0, True, (1.0, 2.0), ()))
    assert _ahead.encoded(signature) == "float64.2C int32.1Cr bool.1C int64 float64 bool float64*2 float64*0"
    assert _ahead.decoded(_ahead.encoded(signature)) == signature


def test_a_listed_kernel_starts_one_process_where_a_core_is_free(monkeypatch):
    started = []
    for where, name, value in ((_ahead.subprocess, "Popen", lambda *command, **_: started.append(command)),
                               (_ahead.atexit, "register", lambda *_: None), (_ahead.os, "cpu_count", lambda: 2),
                               (_ahead, "_one_of_many", lambda: False), (_ahead, "_running", lambda: 1),
                               (numba.config, "NUMBA_NUM_THREADS", 2)):
        monkeypatch.setattr(where, name, value)
    try:
        for where, name, value in ((_ahead, "_one_of_many", lambda: True), (_ahead, "_running", lambda: 2),
                                   (numba.config, "NUMBA_NUM_THREADS", 1)):
            with monkeypatch.context() as patch:
                patch.setattr(where, name, value)
                _ahead._start.cache_clear()
                _ahead.start(improve._swap.py_func)
        _ahead._start.cache_clear()
        _ahead.start(test_signatures_are_read_back)
        assert started == []
        _ahead.start(improve._swap.py_func)
        _ahead.start(improve._across.py_func)
        assert len(started) == 1
    finally:
        _ahead._start.cache_clear()


def test_tests_start_none():
    assert _ahead._one_of_many()


@pytest.mark.parametrize("parent", [os.getpid(), 0], ids=["input closed", "parent gone"])
def test_the_process_compiles_into_the_cache_without_a_word_and_ends_with_its_parent(parent, tmp_path):
    with subprocess.Popen([sys.executable, "-c", f"from adaptmg import _ahead; _ahead.compile_all({parent})"],
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}) as child:
        until = time.monotonic() + 60.0
        while parent and not list(tmp_path.rglob("*.nbc")) and time.monotonic() < until:
            time.sleep(0.05)
        if not parent:
            child.wait(timeout=60.0)  # its input is open
        assert child.communicate(timeout=60.0) == (b"", None) and child.returncode == 0
    # far from the whole list
    assert bool(parent) <= len(list(tmp_path.rglob("*.nbc"))) < 40


def test_flags_that_change_nothing_in_a_called_function_do_not_compile_it_again():
    alike, other = (_Flags(), _Flags()), _Flags()
    alike[0].no_cpython_wrapper, other.fastmath = True, {"contract"}
    assert alike[0] == alike[1] and hash(alike[0]) == hash(alike[1]) and alike[0] != other


def test_functions_of_kernels_alone_have_no_machine_code_and_are_linked():
    inner = inner_kernel(lambda x: 2.0 * x, cache=False)
    outer = kernel(lambda x: inner(x) + 1.0, cache=False)
    assert outer(3.0) == 7.0
    (compiled,) = inner.overloads.values()
    assert type(compiled.library) is _Linked
    assert list(compiled.library.get_defined_functions()) == []
