"""Arrays, masks and sparse matrices that are broken: of problems, couplings, coarse spaces, levels and starts."""

from functools import cache

import numpy as np
from hostile_table import Hostile, each
from scipy import sparse

import adaptmg as am

N = 12  # nodes of a chain


def matrix():
    """A block tridiagonal matrix, symmetric and positive definite."""
    chain = sparse.diags_array([-np.ones(N - 1), 2.1 * np.ones(N), -np.ones(N - 1)], offsets=[-1, 0, 1])
    return sparse.csr_array(sparse.kron(chain, [[2.0, 0.5], [0.5, 1.0]]))


def contact(**changes):
    return am.ContactNodes(**({"nodes": [0, 5], "normals": [[0.0, -1.0], [0.0, -1.0]], "gaps": [0.0, 0.1]} | changes))


def discrete(make=am.DiscreteProblem, **changes):
    parts = {"matrix": matrix(), "load": np.ones(2 * N), "fixed": np.zeros(2 * N, dtype=bool), "law": am.Coulomb(0.3),
             "contact": contact()}
    return make(**(parts | changes))


def weights():
    return sparse.csr_array((np.full(6, 0.5), ([0, 0, 5, 5, 6, 6], [1, 2, 8, 9, 10, 11])), shape=(N, N))


def coupled(**changes):
    return discrete(am.DiscreteProblem.coupled, **({"weights": weights()} | changes))


def halved():
    rows = np.arange(N)
    return sparse.csr_array((np.ones(N), (rows, rows // 2)), shape=(N, N // 2))


def coarse(*prolongations):
    return am.Hierarchy.from_prolongations(discrete(), prolongations)


@cache
def grids():
    return am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4))


def prolongation():
    return sparse.csr_array(grids()[1].prolongation)


def level(**changes):
    fine = grids()[1]
    return am.Level(**({"discrete": fine.discrete, "mesh": fine.mesh, "prolongation": fine.prolongation} | changes))


def two_levels(**changes):
    return am.Hierarchy(levels=(grids()[0], level(**changes)))


def started(value):
    return am.solve(grids(), am.Multigrid(), start=value)


def broken(value, part, change):
    """The matrix with one of its arrays changed behind the constructor's back."""
    value = value.copy()
    setattr(value, part, change(getattr(value, part).copy()))
    return value


def at(index, entry):
    def change(array):
        array[index] = entry
        return array
    return change


BREAKS = {
    "index too large": ("indices", at(3, 10_000_000)), "index negative": ("indices", at(3, -5)),
    "index 2**32": ("indices", lambda a: at(3, 2**32)(a.astype(np.int64))),
    "indices short": ("indices", lambda a: a[:-4]),
    "indices float": ("indices", lambda a: a.astype(float)), "indptr falls": ("indptr", at(3, 0)),
    "indptr beyond": ("indptr", at(-1, 10_000_000)), "indptr begins at 1": ("indptr", at(0, 1)),
    "indptr short": ("indptr", lambda a: a[:-2]), "indptr negative": ("indptr", at(2, -7)),
    "indptr float": ("indptr", lambda a: a.astype(float)), "data short": ("data", lambda a: a[:-3]),
    "data complex": ("data", lambda a: a.astype(complex)), "data nan": ("data", at(0, np.nan)),
    "data objects": ("data", lambda a: a.astype(object)), "data text": ("data", lambda a: a.astype(str)),
}
_FEW = ("index too large", "indptr falls", "data nan")


def _broken_matrices():
    def row(argument, call, make, labels=_FEW):
        return each(argument, lambda change: call(broken(make(), *change)), BREAKS, labels)

    def into(**names):
        return lambda value: discrete(**{name: value for name in names})

    yield from row("csr matrix", into(matrix=1), matrix, tuple(BREAKS))
    yield from row("bsr matrix", into(matrix=1), lambda: sparse.bsr_array(matrix(), blocksize=(2, 2)),
                   ("index too large", "indptr beyond", "data short"))
    yield from row("csc matrix", into(matrix=1), lambda: sparse.csc_array(matrix()), ("index negative", "indptr short"))
    yield from row("old csr_matrix matrix", into(matrix=1), lambda: sparse.csr_matrix(matrix()), ("index too large",))
    yield from row("coupled matrix", lambda v: coupled(matrix=v), matrix, ("index too large",))
    yield from row("coupled weights", lambda v: coupled(weights=v), weights)
    yield from row("prolongations[0]", coarse, halved)
    yield from row("Level prolongation", lambda v: level(prolongation=v), prolongation)
    yield from row("Level surface_prolongation", lambda v: level(surface_prolongation=v), prolongation,
                   ("index too large",))
    for axis, index in ((0, 10_000_000), (1, -3)):
        yield Hostile(f"coo axis {axis}", lambda a=axis, i=index: discrete(matrix=_coo(a, i)), "matrix")


def _coo(axis, index):
    value = sparse.coo_array(matrix())
    value.coords[axis][4] = index
    return value


def _arrays(shape):
    """What is not an array of real numbers of this shape."""
    return {"complex": np.full(shape, 1j), "text": np.full(shape, "0"), "nan": np.full(shape, np.nan),
            "bools": np.zeros(shape, dtype=bool), "None": None, "short": np.zeros((shape[0] - 1, *shape[1:])),
            "flat or a column": np.zeros(2 * shape[0]) if len(shape) == 2 else np.zeros((*shape, 1)),
            "ragged": [[1.0], [1.0, 2.0]]}


_INTEGERS = {"floats": [0.0, 5.0], "bools": [True, False], "text": ["0", "5"], "None": None, "one number": 5,
             "ragged": [[0], [1, 2]], "masked": np.ma.masked_array([0, 5], mask=[0, 1]), "huge": [0, 10**30],
             "wrapped": np.array([0, 2**32 + 5]), "uint64": np.array([0, 2**64 - 3], dtype=np.uint64),
             "mask": np.arange(N) < 2}


def _wrong_arrays():
    yield from each("load", lambda v: discrete(load=v), _arrays((2 * N,)))
    yield from each("solve start", started, _arrays((25, 2)), ("complex", "text", "nan", "short", "ragged"))
    yield from each("ContactNodes nodes", lambda v: discrete(contact=contact(nodes=v)), _INTEGERS)
    few = ("complex",)
    for name, call, shape in (
            ("fixed_values", lambda v: discrete(fixed_values=v), (2 * N,)),
            ("near_nullspace", lambda v: discrete(near_nullspace=v), (2 * N, 1)),
            ("coordinates", lambda v: discrete(coordinates=v), (N, 2)),
            ("ContactNodes normals", lambda v: contact(normals=v), (2, 2)),
            ("ContactNodes gaps", lambda v: contact(gaps=v), (2,)),
            ("ContactNodes weights", lambda v: contact(weights=v), (2,)),
            ("ContactNodes slip_reference", lambda v: contact(slip_reference=v), (2, 2)),
            ("coupled load", lambda v: coupled(load=v), (2 * N,)),
            ("coupled coordinates", lambda v: coupled(coordinates=v), (N, 2)),
            ("solve reference", lambda v: am.solve(grids(), reference=v), (25, 2))):
        yield from each(name, call, _arrays(shape), few)
    masks = {"integers": np.zeros(2 * N, dtype=int), "None": None, "short": np.zeros(2 * N - 1, dtype=bool),
             "ragged": [[True], [True, False]]}
    yield from each("fixed", lambda v: discrete(fixed=v), masks)
    yield from each("coupled fixed", lambda v: coupled(fixed=v), masks, ("None",))
    boundary = {"floats": [0.5, 0.0], "wrapped": np.array([2**32, 0]), "bools": [False, True]}
    yield from each("ContactNodes boundary", lambda v: contact(boundary=v, names=("a", "b")), boundary)


def _wrong_matrices():
    values = {"complex": matrix() * (1 + 0j), "bool": matrix().astype(bool), "text": "A", "None": None,
              "dense": np.eye(2 * N), "one-dimensional": sparse.coo_array(np.ones(24)),
              "empty": sparse.csr_array((0, 0)), "odd": sparse.eye_array(23).tocsr()}
    yield from each("matrix", lambda v: discrete(matrix=v), values)
    yield from each("coupled matrix", lambda v: coupled(matrix=v), values, ("dense", "odd"))
    yield from each("coupled weights", lambda v: coupled(weights=v), {
        "dense": np.eye(N), "None": None, "circle": sparse.csr_array(np.roll(np.eye(N), 1, axis=0)),
        "of another size": sparse.csr_array((N + 1, N + 1))})
    yield from each("prolongations", lambda v: am.Hierarchy.from_prolongations(discrete(), v), {
        "None": None, "one matrix": sparse.csr_array((5, 3)), "text": "P",
        "fine to coarse": [halved(), sparse.csr_array(np.ones((6, 3)))]})
    yield from each("prolongations[0]", coarse, {
        "dense": np.ones((N, 3)), "complex": 1j * halved(), "zero": 0 * halved(), "1e200": 1e200 * halved(),
        "1e-300": 1e-300 * halved(), "without columns": sparse.csr_array((N, 0))})
    yield from each("Level prolongation", lambda v: level(prolongation=v), {
        "dense": np.ones((25, 9)), "complex": 1j * sparse.eye_array(25, 9).tocsr()})
    yield from each("Level galerkin", lambda v: am.Level(None, galerkin=v), {
        "dense": np.eye(4), "csr": sparse.eye_array(4).tocsr()})
    yield from each("levels[1].prolongation", lambda v: two_levels(prolongation=v), {
        "None": None, "short": sparse.eye_array(49, 18).tocsr()})
    yield from each("levels[1].surface_prolongation", lambda v: two_levels(surface_prolongation=v), {
        "short": sparse.eye_array(49, 18).tocsr()})


def _unsymmetric_block():
    """A soft block 32 % unsymmetric next to a stiff one."""
    value = sparse.lil_array(sparse.block_diag([1e12 * matrix(), matrix()]))
    value[2 * N, 2 * N + 2] *= 1.32
    return sparse.csr_array(value)


def _solved(**changes):
    return am.solve(discrete(**changes))


INPUTS = (
    *_broken_matrices(), *_wrong_arrays(), *_wrong_matrices(),
    Hostile("matrix of blocks of three", lambda: discrete(
        matrix=sparse.bsr_array(matrix(), blocksize=(3, 3)), load=np.ones(23)), "load"),
    Hostile("soft unsymmetric block", lambda: discrete(
        matrix=_unsymmetric_block(), load=np.ones(4 * N), fixed=np.zeros(4 * N, dtype=bool)), "symmetric"),
    Hostile("matrix 1e200", lambda: _solved(matrix=1e200 * matrix()), "matrix"),
    Hostile("matrix 1e-300", lambda: _solved(matrix=1e-300 * matrix()), "matrix"),
    Hostile("load 1e300", lambda: _solved(load=np.full(2 * N, 1e300)), "load"),
    Hostile("gaps 1e300", lambda: _solved(contact=contact(gaps=[-1e300, 0.0], allow_interference=True)), "gaps"),
    Hostile("start 1e300", lambda: started(np.full((25, 2), 1e300)), "start"),
    Hostile("coordinates 1e200", lambda: discrete(coordinates=1e200 * np.random.default_rng(0).random((N, 2))),
            "coordinates"),
    Hostile("normals 1e200", lambda: contact(normals=[[0, 1e200], [0, 1]]), "normals"),
    Hostile("weights 1e-320", lambda: contact(weights=[1e-320, 1.0]), "weights"),
    Hostile("near_nullspace flat", lambda: discrete(near_nullspace=np.ones(2 * N)), "near_nullspace"),
    Hostile("near_nullspace sparse", lambda: discrete(near_nullspace=sparse.csr_array(np.ones((2 * N, 1)))),
            "near_nullspace"),
    Hostile("near_nullspace empty", lambda: discrete(near_nullspace=np.ones((2 * N, 0))), "near_nullspace"),
    Hostile("near_nullspace zero", lambda: am.Hierarchy.algebraic(
        discrete(near_nullspace=np.zeros((2 * N, 2))), max_coarse=4), "near_nullspace"),
    Hostile("coupled near_nullspace short", lambda: coupled(near_nullspace=np.ones((3, 1))), "near_nullspace"),
    Hostile("vertices None", lambda: am.Polygon(vertices=None, boundaries=("a",)), "vertices"),
    Hostile("vertices ragged", lambda: am.Polygon(vertices=((0, 0), (1,), (0, 1)), boundaries=("a", "b", "c")),
            "vertices"),
    Hostile("plane without dimension", lambda: am.Plane((), (0.0, 1.0)), "point"),
    Hostile("friction list of text", lambda: am.Coulomb(["1"]), "friction"),
    Hostile("factors ragged", lambda: am.LoadPath({"top": [[1.0], [1.0, 2.0]]}), "factors['top']"),
    Hostile("factors text", lambda: am.LoadPath({"top": "12"}), "factors['top']"),
    Hostile("factors generator", lambda: am.LoadPath({"top": (k for k in range(3))}), "factors['top']"),
    *each("probe points", lambda v: am.solve(grids()).probe(v), {"complex": [[1j, 0.0]], "None": None}),
    *each("resultant about", lambda v: am.solve(grids()).resultant("contact", about=v), {"text": ["0", "0"]}),
    *each("SizeNear points", lambda v: am.SizeNear(v, size=0.1), {"number": 5.0}),
)
