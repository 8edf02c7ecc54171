"""The first solves of the README and of uniform grids; prints each kernel that Python calls in one of them, with its
arguments.

``python tests/helpers/first_solve.py > adaptmg/_ahead.txt`` writes the list for the second process of a first solve.
Kernels of one of the solves alone stand where it needs them.
"""

import difflib
import subprocess
import sys

from numba.core.registry import CPUDispatcher

import adaptmg as am
from adaptmg import _ahead

_called = CPUDispatcher._compile_for_args


def _noted(self, *arguments):
    signature = tuple(map(self.typeof_pyval, arguments))
    print(self.py_func.__module__, self.py_func.__qualname__, _ahead.encoded(signature))
    return _called(self, *arguments)


def _solve(uniform):
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    grids = (am.Hierarchy.uniform(problem, (4, 8, 16, 32)) if uniform else
             am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4))
    result = am.solve(grids)
    result.certificate()
    result.probe([(0.0, 0.0), (0.005, 0.0)])


if __name__ == "__main__":
    if sys.argv[1:]:
        CPUDispatcher._compile_for_args = _noted
        _solve(sys.argv[1] == "uniform")
    else:
        lists = [subprocess.run([sys.executable, __file__, name], stdout=subprocess.PIPE, check=True, text=True
                                ).stdout.splitlines() for name in ("graded", "uniform")]
        print("\n".join(dict.fromkeys(line[2:] for line in difflib.ndiff(*lists) if line[0] != "?")))
