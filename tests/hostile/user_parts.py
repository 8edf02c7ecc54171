"""Functions, transfers, laws, smoothers, corrections and solvers of a user that return what they
must not."""

from types import SimpleNamespace

import numpy as np
from arrays_and_matrices import discrete
from hostile_table import each
from scipy import sparse

import adaptmg as am
from adaptmg.smoother.linear import LinearSolution
from adaptmg.solver.record import Outcome


def _bar(**changes):
    return am.cases.greco_bar(**changes)


def _grids(transfer=None, problem=None):
    problem = problem or _bar()
    return am.Hierarchy.from_meshes(
        problem, [am.mesh.structured(problem.domain, n) for n in (2, 4, 8)], transfer=transfer
    )


def _by(**parts):
    return am.solve(_grids(), am.FullMultigrid(**parts))


def _square(contact=None, **changes):
    parts = {
        "material": am.PlaneStrain(young=1e9, poisson=0.3),
        "law": am.Coulomb(0.3),
        "domain": am.Rectangle(width=1.0, height=1.0),
        "supports": (am.Support("right", x=0.0),),
        "contact": am.Contact("bottom", contact or am.Plane((0.0, 0.0), (0.0, 1.0))),
    }
    return am.Hierarchy.uniform(am.ContactProblem(**(parts | changes)), divisions=(2, 4))


def _functions():
    values = {
        "None": lambda p: None,
        "bool": lambda p: p[:, 0] > 0,
        "shape": lambda p: p,
        "1e300": lambda p: 1e300,
        "masked": lambda p: np.ma.masked_array(0 * p[:, 0], mask=p[:, 0] > 0.2),
    }
    yield from each("function friction", lambda v: _square(law=am.Coulomb(v)), values)
    yield from each("function gap", lambda v: _square(am.GapFunction(v)), values, ("None",))
    yield from each(
        "function pressure on top",
        lambda v: _square(loads=(am.Pressure("top", v),)),
        values,
        ("None",),
    )


def _transfers():
    """Interpolation, changed."""

    def outside(matrix):
        matrix.indices = matrix.indices.copy()
        matrix.indices[5] = 10_000_000
        return matrix

    changes = {
        "dense": lambda m: m.toarray(),
        "transposed": lambda m: m.T,
        "outside": outside,
        "complex": lambda m: m * 1j,
        "huge": lambda m: m * 1e200,
    }
    yield from each(
        "transfer.build",
        lambda change: _grids(
            SimpleNamespace(
                build=lambda coarse, fine: change(
                    sparse.csr_array(am.Interpolation().build(coarse, fine))
                )
            )
        ),
        changes,
    )


def _smoother(work):
    def smooth(system, contact, load, unknowns, sweeps=1):
        am.ProjectedGaussSeidel().smooth(system, contact, load, unknowns, sweeps)
        return work

    return SimpleNamespace(smooth=smooth)


def _methods():
    counts = {"negative": -1.0, "nan": np.nan, "array": np.ones(3)}
    yield from each(
        "work of a smoother", lambda v: _by(smoother=_smoother(v), correction=am.Monotone()), counts
    )

    transported = {
        "two": lambda gap, slip, limit: (gap, slip),
        "flat slip": lambda gap, slip, limit: (gap, slip.ravel(), limit),
    }
    yield from each(
        "correction",
        lambda change: _by(
            correction=SimpleNamespace(
                needs_initial=False,
                transport=lambda *given: change(*am.Monotone().transport(*given)),
            )
        ),
        transported,
    )
    yield from each(
        "correction",
        lambda v: am.Multigrid(correction=SimpleNamespace(transport=v)),
        {"without needs_initial": print},
    )

    solutions = {
        "an array": lambda b: b,
        "short": lambda b: LinearSolution(b[:3], 1, 1.0, 0.0, True),
        "negative passes": lambda b: LinearSolution(b, 1, -5.0, 0.0, True),
    }
    yield from each(
        "linear",
        lambda solution: am.solve(_grids(), am.ActiveSet(linear=_Linear(solution))),
        solutions,
    )
    yield from each(
        "linear",
        lambda v: am.solve(
            _grids(),
            am.ActiveSet(
                linear=SimpleNamespace(setup=lambda matrix, near_nullspace=None, **options: v)
            ),
        ),
        {"prepares text": "ready"},
    )

    answers = {"None": lambda b: None, "short": lambda b: b[1:], "NaN": lambda b: b * np.nan}
    yield from each("coarse_solve", lambda v: _truncated(coarse_solve=_CoarsePart(v)), answers)
    yield from each(
        "passes of a coarse_solve",
        lambda v: _truncated(coarse_solve=_CoarsePart(np.copy, v)),
        counts,
        ("negative",),
    )
    yield from each(
        "passes of a coarse_smoother",
        lambda v: _truncated(coarse_smoother=_CoarsePart(lambda b: v)),
        counts,
        ("negative",),
    )
    yield from each(
        "passes of smooth",
        lambda v: _truncated(smooth=SimpleNamespace(smooth=lambda *arguments: v)),
        counts,
        ("negative",),
    )
    yield from each(
        "the unknowns that smooth leaves",
        lambda v: _truncated(
            smooth=SimpleNamespace(smooth=lambda system, contact, load, u, sweeps: u.fill(v) or 1.0)
        ),
        {"nan": np.nan, "inf": np.inf},
    )
    values = {
        "None": lambda after: None,
        "short": lambda after: after[1:],
        "NaN": lambda after: after * np.nan,
    }
    yield from each(
        "project",
        lambda v: _truncated(
            project=SimpleNamespace(project=lambda contact, before, after: v(after))
        ),
        values,
    )


class _Linear:
    """A linear solver whose solution is ``solution(rhs)``."""

    def __init__(self, solution):
        self.solution = solution

    def setup(self, matrix, near_nullspace=None, **options):
        return self

    def solve(self, rhs, start=None, rtol=1e-10):
        return self.solution(rhs)


class _CoarsePart:
    """A linear coarse solve and smoother that returns ``answer(rhs)``; ``passes`` is what it
    counts."""

    def __init__(self, answer, passes=0.0):
        self.answer, self.passes = answer, passes

    def setup(self, matrix):
        return self

    def solve(self, rhs):
        return self.answer(rhs)

    def smooth(self, rhs, x):
        return self.answer(rhs)


def _truncated(**parts):
    return _by(correction=am.Truncated(**parts))


def _solver(outcome):
    return SimpleNamespace(run=lambda hierarchy, run, start: outcome(hierarchy.finest.discrete))


def _solvers():
    def changed(**changes):
        def make(d):
            good = {
                "solution": np.zeros((d.n_nodes, d.dim)),
                "status": am.Status.LIMIT,
                "cycles": 1,
                "rtol": 1e-8,
            }
            return Outcome(**(good | {k: v(d) if callable(v) else v for k, v in changes.items()}))

        return make

    made = {
        "None": lambda d: None,
        "the class Outcome": lambda d: Outcome,
        "solution short": changed(solution=np.zeros((3, 2))),
        "solution complex": changed(solution=lambda d: np.zeros((d.n_nodes, 2), dtype=complex)),
        "status text": changed(status="converged"),
        "cycles float": changed(cycles=1.5),
        "rtol nan": changed(rtol=np.nan),
        "rtol 1e30": changed(rtol=1e30),
        "rate None": changed(rate=None),
        "error_estimate negative": changed(error_estimate=-1.0),
    }
    yield from each("solver", lambda v: am.solve(_grids(), _solver(v), throw=False), made)
    yield from each(
        "path solver",
        lambda v: am.solve_path(_grids(), am.LoadPath(default=[0.5, 1.0]), _solver(v)),
        made,
        ("None", "solution short"),
    )


def _laws():
    def law(bounds=None, at_nodes=None):
        value = SimpleNamespace(bounds=bounds)
        value.at_nodes = lambda points, weights: value if at_nodes is None else at_nodes(points)
        return value

    yield from each(
        "law",
        lambda v: _grids(problem=_bar(law=law(at_nodes=v, bounds=print))),
        {"at_nodes None": lambda p: None, "at_nodes a class": lambda p: am.Coulomb},
    )
    bounds = {
        "one array": lambda n: np.zeros(n),
        "three": lambda n: (np.zeros(n),) * 3,
        "short": lambda n: (np.zeros(n - 1), np.zeros(n)),
        "nan": lambda n: (np.zeros(n), np.full(n, np.nan)),
        "negative": lambda n: (np.full(n, -1.0), np.zeros(n)),
    }
    yield from each("bounds of a law", lambda v: discrete(law=law(v)), bounds)
    yield from each(
        "bounds in a problem of a law", lambda v: _grids(problem=_bar(law=law(v))), bounds, ("nan",)
    )


def _obstacles():
    answers = {
        "normals alone": lambda x, n: n,
        "gaps short": lambda x, n: (n, np.zeros(1)),
        "normals long": lambda x, n: (5 * n, np.zeros(len(x))),
    }
    yield from each("obstacle at bottom", lambda v: _square(SimpleNamespace(contact=v)), answers)


INPUTS = (*_functions(), *_transfers(), *_methods(), *_solvers(), *_laws(), *_obstacles())
