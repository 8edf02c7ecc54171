"""Kernels: their options, where no cache can be written, and what is said and counted while they
are compiled."""

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.extending import overload

import adaptmg as am
from adaptmg._numba import compiling_seconds, inner_kernel, kernel

ROOT = Path(am.__file__).parent


@inner_kernel(cache=False, fastmath=True)
def _twice(value):
    return 2.0 * value


def test_a_kernel_calls_inner_ones_and_divides_as_numpy_does():
    @kernel(cache=False)
    def over(a, b):
        return _twice(a) / b

    assert over(2.0, 4.0) == 1.0 and over(1.0, 0.0) == np.inf


def test_compiling_is_counted():
    @kernel(cache=False)
    def once(a):
        return _twice(a) + 1.0

    before = compiling_seconds()
    assert once(1.0) == 3.0
    after = compiling_seconds()
    assert after > before
    once(2.0)
    assert compiling_seconds() == after


@pytest.mark.parametrize("collects", [True, False])
def test_the_collector_rests_while_kernels_compile_and_is_then_as_before(collects):
    collected = []

    def one():
        return 1.0

    @overload(one)
    def _compiled_one():
        collected.append(gc.isenabled())
        return lambda: 1.0

    @kernel(cache=False)
    def two():
        return one() + 1.0

    @kernel(cache=False)
    def impossible():
        return one().missing

    if not collects:
        gc.disable()
    try:
        assert two() == 2.0
        assert gc.isenabled() == collects
        with pytest.raises(TypingError):
            impossible()
        assert gc.isenabled() == collects
    finally:
        gc.enable()
    assert collected and not any(collected)


@pytest.fixture
def package(tmp_path):
    """A copy of the package without any cache; a function that runs code on it in a new process."""
    copy = tmp_path / "src" / "adaptmg"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def run(code: str, **environment: str) -> str:
        done = subprocess.run(
            [sys.executable, "-B", "-c", code],
            capture_output=True,
            text=True,
            timeout=200,
            cwd=tmp_path,
            env={k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
            | {"PYTHONPATH": str(copy.parent)}
            | environment,
        )
        assert done.returncode == 0, done.stderr
        return done.stderr

    return copy / "geometry", run


TREE = (
    "import numpy as np\nfrom adaptmg.geometry.search import BoxTree\n"
    "assert len(BoxTree(np.random.default_rng(1).random((5, 2)), np.eye(5, 3, dtype=np.int32)).boxes) == 3\n"
)


def test_kernels_run_where_no_cache_can_be_written(package):
    folder, run = package
    # a file where numba would make its directory: not even root can write there
    (folder / "__pycache__").write_text("a file")
    said = run(TREE, HOME=os.devnull, XDG_CACHE_HOME=os.path.join(os.devnull, "cache"))
    assert said.count("compiled kernels are not stored") == 1


def test_long_compiling_is_announced_once_stored_kernels_never(package):
    _, run = package
    long = "import adaptmg._numba as n\nn._COMPILING.here.seconds = 100.0\n"
    assert run(long + TREE).startswith("adaptmg: compiling kernels of geometry")
    assert run(long + TREE) == ""
