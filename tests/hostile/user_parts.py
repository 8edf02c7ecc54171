"""Transfers, laws, smoothers, corrections, linear solvers and solvers of one's own that do not keep their word."""

import numpy as np
from hostile_table import Hostile
from scipy import sparse

import adaptmg as am
from adaptmg.solver.linear import LinearSolution
from adaptmg.solver.record import Outcome


def _problem(**changes):
    return am.cases.greco_bar(**changes)


def _grids(transfer=None, problem=None):
    problem = _problem() if problem is None else problem
    meshes = [am.mesh.structured(problem.domain, n) for n in (2, 4, 8)]
    return am.Hierarchy.from_meshes(problem, meshes, transfer=transfer)


class _Transfer:
    """Interpolation, changed."""

    def __init__(self, change):
        self.change = change

    def build(self, coarse, fine):
        return self.change(sparse.csr_array(am.Interpolation().build(coarse, fine)))


def _with(part, index, value):
    def change(matrix):
        array = np.array(getattr(matrix, part), dtype=np.int64 if part != "data" else type(value))
        array[index] = value
        setattr(matrix, part, array)
        return matrix
    return change


def _transfers():
    changes = {
        "None": lambda m: None, "dense": lambda m: m.toarray(), "text": lambda m: "P", "transposed": lambda m: m.T,
        "index too large": _with("indices", 5, 10_000_000), "index negative": _with("indices", 5, -9),
        "index 2**33": _with("indices", 5, 2**33), "indptr falls": _with("indptr", 4, 0),
        "indptr beyond": _with("indptr", -1, 10**9), "complex": lambda m: m * 1j, "nan": _with("data", 0, np.nan),
        "infinite": _with("data", 0, np.inf), "bool": lambda m: m.astype(bool), "wrong rows": lambda m: m[:-1],
        "zero": lambda m: m * 0.0, "huge": lambda m: m * 1e200, "tiny": lambda m: m * 1e-300,
        "tuple": lambda m: (m, m), "list": lambda m: m.toarray().tolist(),
        "coo": lambda m: _broken_coo(sparse.coo_array(m)),
    }
    for label, change in changes.items():
        yield Hostile(f"transfer {label}", lambda c=change: _grids(_Transfer(c)), "transfer.build")
    for cls in (am.L2, am.Interpolation, am.PseudoL2, _Transfer):
        yield Hostile(f"transfer class {cls.__name__}", lambda c=cls: _grids(c), "transfer")


def _broken_coo(matrix):
    matrix.coords[1][3] = 10**7
    return matrix


class _Smoother:
    """The projected Gauss-Seidel smoother with another account of its work, or worse."""

    def __init__(self, work=None, spoil=None):
        self.work, self.spoil = work, spoil

    def smooth(self, system, contact, load, unknowns, sweeps=1):
        am.ProjectedGaussSeidel().smooth(system, contact, load, unknowns, sweeps)
        if self.spoil is not None:
            self.spoil(unknowns)
        return self.work


def _by(**parts):
    return am.solve(_grids(), am.FullMultigrid(**parts))


def _smoothers():
    for label, work in {"negative": -1.0, "nan": np.nan, "None": None, "text": "1", "True": True, "complex": 1j,
                        "array": np.ones(3), "infinite": np.inf, "huge": 10**400}.items():
        yield Hostile(f"smoother work {label}",
                      lambda w=work: _by(smoother=_Smoother(w), correction=am.Monotone()), "smoother")
    yield Hostile("smoother class", lambda: am.Multigrid(smoother=am.ProjectedGaussSeidel), "smoother")
    yield Hostile("smoother None", lambda: am.Multigrid(smoother=None), "smoother")
    yield Hostile("smoother text", lambda: am.Multigrid(smoother="jacobi"), "smoother")


class _Correction:
    """A correction that hands on what it is told to."""

    def __init__(self, change, needs_initial=False):
        self.change, self.needs_initial = change, needs_initial

    def transport(self, reach, opening, slip, limit, initial):
        return self.change(*am.Monotone().transport(reach, opening, slip, limit, initial))


def _corrections():
    changes = {
        "None": lambda gap, slip, limit: None, "two": lambda gap, slip, limit: (gap, slip),
        "short gap": lambda gap, slip, limit: (gap[:-1], slip, limit),
        "text": lambda gap, slip, limit: ("a", slip, limit),
        "complex": lambda gap, slip, limit: (gap * 1j, slip, limit),
        "flat slip": lambda gap, slip, limit: (gap, slip.ravel(), limit),
        "integers": lambda gap, slip, limit: (gap, slip, "limit"),
        "number": lambda gap, slip, limit: 5,
    }
    for label, change in changes.items():
        yield Hostile(f"correction {label}", lambda c=change: _by(correction=_Correction(c)), "correction")
    yield Hostile("correction class", lambda: am.Multigrid(correction=am.Truncated), "correction")
    yield Hostile("correction class of Monotone", lambda: am.Multigrid(correction=am.Monotone), "correction")
    yield Hostile("correction as text", lambda: am.Multigrid(correction="monotone"), "correction")
    yield Hostile("correction without needs_initial", lambda: am.Multigrid(correction=_Transfer(None)), "correction")


class _Solver:
    """A solver that returns what it is told to."""

    def __init__(self, outcome):
        self.outcome = outcome

    def run(self, hierarchy, run, start):
        return self.outcome(hierarchy.finest.discrete)


def _outcome(**changes):
    def make(discrete):
        good = {"displacement": np.zeros((discrete.n_nodes, discrete.dim)), "status": am.Status.LIMIT, "cycles": 1,
                "rtol": 1e-8}
        return Outcome(**(good | {k: v(discrete) if callable(v) else v for k, v in changes.items()}))
    return make


def _solvers():
    made = {
        "None": lambda d: None, "an array": lambda d: np.zeros(d.n_dofs), "text": lambda d: "done",
        "the class Outcome": lambda d: Outcome,
        "displacement None": _outcome(displacement=None), "displacement text": _outcome(displacement="u"),
        "displacement short": _outcome(displacement=np.zeros((3, 2))),
        "displacement complex": _outcome(displacement=lambda d: np.zeros((d.n_nodes, 2), dtype=complex)),
        "displacement bools": _outcome(displacement=lambda d: np.zeros((d.n_nodes, 2), dtype=bool)),
        "status text": _outcome(status="converged"), "status None": _outcome(status=None),
        "cycles float": _outcome(cycles=1.5), "cycles negative": _outcome(cycles=-1),
        "rtol text": _outcome(rtol="1e-8"), "rtol nan": _outcome(rtol=np.nan), "rtol 1e30": _outcome(rtol=1e30),
        "cycles None": _outcome(cycles=None),
        "error_estimate text": _outcome(error_estimate="0"), "rate None": _outcome(rate=None),
        "error_estimate negative": _outcome(error_estimate=-1.0),
    }
    for label, outcome in made.items():
        yield Hostile(f"solver returns {label}",
                      lambda o=outcome: am.solve(_grids(), _Solver(o), throw=False), "solver")
        if label in ("None", "status text", "displacement short"):
            yield Hostile(f"solver of a path returns {label}", lambda o=outcome: am.solve_path(
                _grids(), am.LoadPath(default=[0.5, 1.0]), _Solver(o)), "solver")
    for cls in (am.FullMultigrid, am.Multigrid, am.SingleGrid, am.ActiveSet, _Solver):
        yield Hostile(f"solver class {cls.__name__}", lambda c=cls: am.solve(_grids(), c), "solver")
    yield Hostile("solver class for a path", lambda: am.solve_path(_grids(), am.LoadPath(), am.FullMultigrid), "solver")
    yield Hostile("solver text", lambda: am.solve(_grids(), "multigrid"), "solver")


class _Linear:
    """A linear solver that prepares or returns what it is told to."""

    def __init__(self, prepared=None, solution=None):
        self.prepared, self.solution = prepared, solution

    def setup(self, matrix, near_nullspace=None, **options):
        return self if self.prepared is None else self.prepared

    def solve(self, rhs, start=None, rtol=1e-10):
        return self.solution(rhs)


def _active_set(linear):
    return am.solve(_grids(), am.ActiveSet(linear=linear))


def _linear_solvers():
    made = {
        "None": lambda b: None, "an array": lambda b: b, "short": lambda b: LinearSolution(b[:3], 1, 1.0, 0.0, True),
        "complex": lambda b: LinearSolution(b * 1j, 1, 1.0, 0.0, True),
        "text": lambda b: LinearSolution("x", 1, 1.0, 0.0, True),
        "negative passes": lambda b: LinearSolution(b, 1, -5.0, 0.0, True),
        "passes None": lambda b: LinearSolution(b, 1, None, 0.0, True),
    }
    for label, solution in made.items():
        yield Hostile(f"linear {label}", lambda s=solution: _active_set(_Linear(solution=s)), "linear")
    yield Hostile("linear prepares text", lambda: _active_set(_Linear(prepared="ready")), "linear")
    yield Hostile("linear class", lambda: am.ActiveSet(linear=am.Direct), "linear")
    yield Hostile("linear class AMG", lambda: am.ActiveSet(linear=am.AMG), "linear")
    yield Hostile("linear as text", lambda: am.ActiveSet(linear="direct"), "linear")


class _CoarsePart:
    """A linear coarse solve and smoother that answers what it is told; ``passes`` is what it counts."""

    def __init__(self, answer, passes=0.0):
        self.answer, self.passes = answer, passes

    def setup(self, matrix):
        return self

    def solve(self, rhs):
        return self.answer(rhs)

    def smooth(self, rhs, x):
        return self.answer(rhs)


def _coarse_parts():
    def truncated(**parts):
        return _by(correction=am.Truncated(**parts))

    for label, answer in {"None": lambda b: None, "short": lambda b: b[1:], "complex": lambda b: b * 1j,
                          "text": lambda b: "x", "NaN": lambda b: b * np.nan}.items():
        yield Hostile(f"coarse solve {label}", lambda a=answer: truncated(coarse_solve=_CoarsePart(a)), "coarse_solve")
    for label, passes in {"negative": -1.0, "None": None, "NaN": np.nan}.items():
        yield Hostile(f"coarse solve passes {label}",
                      lambda p=passes: truncated(coarse_solve=_CoarsePart(np.copy, p)), "coarse_solve")
        yield Hostile(f"coarse smoother passes {label}",
                      lambda p=passes: truncated(coarse_smoother=_CoarsePart(lambda b: p)), "coarse_smoother")
    for name in ("coarse_solve", "coarse_smoother"):
        yield Hostile(f"{name} class", lambda n=name: truncated(**{n: _CoarsePart}), name)
        yield Hostile(f"{name} text", lambda n=name: truncated(**{n: "direct"}), name)


class _Law:
    """A law whose nodal form and bounds are what it is told."""

    def __init__(self, nodal=None, bounds=None):
        self.nodal, self.made = nodal, bounds

    def at_nodes(self, points, weights):
        return self if self.nodal is None else self.nodal(points)

    def bounds(self, n_contact):
        return self.made(n_contact)


def _laws():
    for label, nodal in {"None": lambda p: None, "an array": lambda p: p, "number": lambda p: 0.3,
                         "text": lambda p: "law", "class": lambda p: am.Coulomb}.items():
        yield Hostile(f"at_nodes {label}", lambda n=nodal: _grids(problem=_problem(law=_Law(nodal=n))), "law")
    for label, made in {"None": lambda n: None, "short": lambda n: (np.zeros(1), np.zeros(1)),
                        "negative": lambda n: (np.zeros(n), -np.ones(n)), "text": lambda n: ("a", "b"),
                        "nan": lambda n: (np.full(n, np.nan), np.zeros(n))}.items():
        yield Hostile(f"bounds {label}", lambda m=made: _grids(problem=_problem(law=_Law(bounds=m))), "law")


class _Obstacle:
    """An obstacle that answers what it is told to."""

    def __init__(self, answer):
        self.answer = answer

    def contact(self, points, normals):
        return self.answer(points, normals)


def _obstacles():
    made = {
        "None": lambda x, n: None, "normals alone": lambda x, n: n, "gaps short": lambda x, n: (n, np.zeros(1)),
        "gaps text": lambda x, n: (n, np.full(len(x), "0")), "gaps nan": lambda x, n: (n, np.full(len(x), np.nan)),
        "gaps complex": lambda x, n: (n, np.full(len(x), 1j)), "normals long": lambda x, n: (5 * n, np.zeros(len(x))),
        "normals complex": lambda x, n: (n * 1j, np.zeros(len(x))), "number": lambda x, n: 5,
        "three": lambda x, n: (n, np.zeros(len(x)), 1), "normals text": lambda x, n: (n.astype(str), np.zeros(len(x))),
    }
    for label, answer in made.items():
        yield Hostile(f"obstacle {label}", lambda a=answer: _grids(problem=am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3), law=am.Coulomb(0.3),
            domain=am.Rectangle(width=1.0, height=1.0), contact=am.Contact("bottom", _Obstacle(a)),
            supports=(am.Support("right", x=0.0),))), "bottom")
    yield Hostile("obstacle with contact as data", lambda: am.Contact(
        "bottom", type("Data", (), {"contact": 5})()), "obstacle")


INPUTS = (*_transfers(), *_smoothers(), *_corrections(), *_solvers(), *_linear_solvers(), *_coarse_parts(),
          *_laws(), *_obstacles())
