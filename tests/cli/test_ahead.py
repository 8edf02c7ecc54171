"""A second process compiles the kernels of a first solve ahead of the one that needs them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

#: prints kernels that are called from Python, with the types of their arguments
SOLVED = """
import sys
from numba.core import types
from numba.core.registry import CPUDispatcher
import adaptmg as am
grids = am.Hierarchy.graded(am.cases.upset_block(), (5e-3, 3e-3, 2e-3))
am.solve(grids, throw=False).certificate()
for name, module in list(sys.modules.items()):
    for kernel in list(vars(module).values()) if name.startswith("adaptmg.") else ():
        if isinstance(kernel, CPUDispatcher) and kernel.py_func.__module__ == name:
            if not kernel.targetoptions.get("no_cpython_wrapper"):
                for signature in kernel.signatures:
                    print(name, kernel.__name__, signature)
"""
RECORDED = """
from adaptmg.cli.ahead import record_first_solve
for kernel, types in record_first_solve():
    print(kernel.py_func.__module__, kernel.py_func.__name__, types)
"""
#: begins to solve a uniform plane problem, prints the number of the other process, and waits for it
BEGUN = """
import os, sys, time
from pathlib import Path
import adaptmg._machine as machine
machine.has_idle_processor = lambda: True
import adaptmg as am, psutil
sys.path.append(Path("x"))  # Python ignores it
am.Hierarchy.uniform(am.cases.greco_bar(), (2,))
for child in psutil.Process().children():
    print(child.pid, flush=True)
    while not list(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("energy_error.*.nbi")):
        time.sleep(0.1)
"""
#: prints how many threads wait for another process: where one thread is allowed, where no processor is
#: idle, and otherwise; then ends that process, and prints whether the system still lists it
STARTED = """
import os, threading, time
import psutil
import adaptmg._numba as compiling
before = threading.active_count()
for threads, idle in (("1", True), ("2", False), ("2", True)):
    os.environ["NUMBA_NUM_THREADS"] = threads
    compiling.has_idle_processor = lambda: idle
    compiling._compile_ahead.cache_clear()
    compiling._compile_ahead()
    print(threading.active_count() - before)
while not (children := psutil.Process().children()):
    time.sleep(0.01)
children[0].kill()
end = time.monotonic() + 10.0
while psutil.pid_exists(children[0].pid) and time.monotonic() < end:
    time.sleep(0.01)
print(psutil.pid_exists(children[0].pid))
"""


def run(code: str, folder: Path, **environment: str) -> list[str]:
    """Return the lines that a new process in a folder prints; warnings are errors."""
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", "-c", code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        env=os.environ | environment,
    )
    assert done.returncode == 0 and "Warning" not in done.stderr, done.stderr
    return done.stdout.splitlines()


def test_the_second_process_knows_the_kernels_of_a_first_solve(tmp_path: Path):
    called = set(run(SOLVED, tmp_path))
    recorded = set(run(RECORDED, tmp_path))
    assert len(called) > 30 and called <= recorded


def test_a_second_process_needs_an_idle_processor_and_leaves_no_zombie(tmp_path: Path):
    assert run(STARTED, tmp_path) == ["0", "0", "1", "False"]


@pytest.mark.slow
def test_a_second_process_compiles_what_a_first_solve_needs_and_ends_with_the_first(tmp_path: Path):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_NUM_THREADS": "2"}
    # neither process may import a file of the working directory
    Path(tmp_path, "numba.py").write_text("raise ImportError", encoding="utf-8")
    (child,) = run(BEGUN, tmp_path, **environment)
    end = time.monotonic() + 60.0
    while Path("/proc", child).exists():
        assert time.monotonic() < end
        time.sleep(0.1)
