"""What importing a part of the package loads; the layers themselves are checked by import-linter (pyproject.toml)."""

from __future__ import annotations

import subprocess
import sys

import pytest


def _loaded(statement: str) -> set[str]:
    """Top-level modules loaded by a statement in a fresh interpreter."""
    code = f"import sys\n{statement}\nsys.stdout.write(' '.join(sorted({{n.split('.')[0] for n in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("module", ["adaptmg", "adaptmg.problem", "adaptmg.discrete.problem", "adaptmg.transfer",
                                    "adaptmg.mesh", "adaptmg.hierarchy", "adaptmg.solver.solve", "adaptmg.cases",
                                    "adaptmg.cli"])
def test_importing_does_not_load_ngsolve(module):
    assert not {"ngsolve", "netgen"} & _loaded(f"import {module}")


def test_the_check_of_loaded_modules_can_fail():
    assert "sqlite3" in _loaded("import sqlite3") and "sqlite3" not in _loaded("pass")
