"""The README's solve; prints each kernel that Python calls in it, with its arguments.

``python tests/helpers/first_solve.py > adaptmg/_ahead.txt`` writes the list for the second process of a first solve.
"""

from numba.core.registry import CPUDispatcher

import adaptmg as am
from adaptmg import _ahead

_called = CPUDispatcher._compile_for_args


def _noted(self, *arguments):
    signature = tuple(map(self.typeof_pyval, arguments))
    print(self.py_func.__module__, self.py_func.__qualname__, _ahead.encoded(signature))
    return _called(self, *arguments)


if __name__ == "__main__":
    CPUDispatcher._compile_for_args = _noted
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    grids = am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
    result = am.solve(grids)
    result.certificate()
    result.probe([(0.0, 0.0), (0.005, 0.0)])
