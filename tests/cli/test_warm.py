"""``adaptmg warm`` calls the kernels, so that numba compiles and stores them."""

import importlib
import pkgutil
import subprocess
import sys
from inspect import isfunction
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher

import adaptmg as am
from adaptmg.smoother import node_solve


def kernels() -> dict[str, CPUDispatcher]:
    """Kernels that only Python calls, by name."""
    found = {}
    for module in pkgutil.walk_packages(am.__path__, "adaptmg."):
        if not module.name.endswith("__main__"):
            for name, value in vars(importlib.import_module(module.name)).items():
                if isinstance(value, CPUDispatcher) and value.py_func.__module__ == module.name:
                    found[f"{module.name}.{name}"] = value
    # those that kernels call are part of the stored code of these, and not loaded; kernels call the
    # plain functions of node solves, too
    callers = [kernel.py_func for kernel in found.values()]
    callers += [function for function in vars(node_solve).values() if isfunction(function)]
    inner = {name for caller in callers for name in caller.__code__.co_names}
    return {
        name: value
        for name, value in found.items()
        if not value.targetoptions.get("no_cpython_wrapper") and name.split(".")[-1] not in inner
    }


@pytest.mark.slow
def test_warm_calls_every_kernel():
    # the command itself by one of the solves: its processes take the others alike
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import test_warm\n"
        "from adaptmg.cli import main, warm\n"
        "for name in warm.STEPS: warm.solve_step(name)\n"
        "print(*(name for name, kernel in test_warm.kernels().items() if not kernel.signatures))\n"
        "warm.STEPS = {'coarse spaces of a matrix': None}\n"
        "main(['warm'])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert kernels() and not run.stdout.split()
    assert "coarse spaces" in run.stderr
