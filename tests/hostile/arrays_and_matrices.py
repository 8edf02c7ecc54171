"""Arrays, masks and sparse matrices that are broken: of problems, couplings, coarse spaces, levels
and starts."""

from functools import cache

import numpy as np
from hostile_table import Hostile, each, labelled, words
from scipy import sparse

import adaptmg as am

N = 12  # nodes of a chain


def matrix():
    """A block tridiagonal matrix, symmetric and positive definite."""
    chain = sparse.diags_array(
        [-np.ones(N - 1), 2.1 * np.ones(N), -np.ones(N - 1)], offsets=[-1, 0, 1]
    )
    return sparse.csr_array(sparse.kron(chain, [[2.0, 0.5], [0.5, 1.0]]))


def contact(**changes):
    return am.ContactNodes(
        **({"nodes": [0, 5], "normals": [[0.0, -1.0], [0.0, -1.0]], "gaps": [0.0, 0.1]} | changes)
    )


def discrete(**changes):
    parts = {
        "matrix": matrix(),
        "load": np.ones(2 * N),
        "fixed": np.zeros(2 * N, dtype=bool),
        "law": am.Coulomb(0.3),
        "contact": contact(),
    }
    return am.DiscreteProblem(**(parts | changes))


def weights():
    return sparse.csr_array(
        (np.full(6, 0.5), ([0, 0, 5, 5, 6, 6], [1, 2, 8, 9, 10, 11])), shape=(N, N)
    )


def coupled(**changes):
    own = changes.pop("weights", None)
    return discrete(**changes).coupled(weights() if own is None else own)


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
    return am.Level(
        **(
            {"discrete": fine.discrete, "mesh": fine.mesh, "prolongation": fine.prolongation}
            | changes
        )
    )


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
    "index too large": ("indices", at(3, 10_000_000)),
    "index negative": ("indices", at(3, -5)),
    "index 2**32": ("indices", lambda a: at(3, 2**32)(a.astype(np.int64))),
    "indptr falls": ("indptr", at(3, 0)),
    "indptr beyond": ("indptr", at(-1, 10_000_000)),
    "indptr begins at 1": ("indptr", at(0, 1)),
    "indptr short": ("indptr", lambda a: a[:-2]),
    "indptr float": ("indptr", lambda a: a.astype(float)),
    "data short": ("data", lambda a: a[:-3]),
    "data nan": ("data", at(0, np.nan)),
    "data objects": ("data", lambda a: a.astype(object)),
}


def _broken_matrices():
    """Every break of one matrix, one of each other kind and argument."""

    def coo():
        value = sparse.coo_array(matrix())
        value.coords[0][4] = 10_000_000
        return value

    def row(argument, call, make, labels=("index too large",)):
        return each(argument, lambda change: call(broken(make(), *change)), BREAKS, labels)

    def into(value):
        return discrete(matrix=value)

    yield from row("csr matrix", into, matrix, tuple(BREAKS))
    yield from row("bsr matrix", into, lambda: sparse.bsr_array(matrix(), blocksize=(2, 2)))
    yield from row("csc matrix", into, lambda: sparse.csc_array(matrix()))
    yield from row("old csr_matrix matrix", into, lambda: sparse.csr_matrix(matrix()))
    yield Hostile("coo matrix", lambda: into(coo()), "matrix")
    yield from row("coupled weights", lambda v: coupled(weights=v), weights)
    yield from row("prolongations[0]", coarse, halved)
    yield from row("Level prolongation", lambda v: level(prolongation=v), prolongation)


def _arrays(shape):
    """What is not an array of real numbers of this shape."""
    return {
        "complex": np.full(shape, 1j),
        "text": np.full(shape, "0"),
        "nan": np.full(shape, np.nan),
        "bools": np.zeros(shape, dtype=bool),
        "short": np.zeros((shape[0] - 1, *shape[1:])),
        "ragged": [[1.0], [1.0, 2.0]],
    }


_INTEGERS = {
    "floats": [0.0, 5.0],
    "bools": [True, False],
    "one number": 5,
    "ragged": [[0], [1, 2]],
    "masked": np.ma.masked_array([0, 5], mask=[0, 1]),
    "huge": [0, 10**30],
    "wrapped": np.array([0, 2**32 + 5]),
    "uint64": np.array([0, 2**64 - 3], dtype=np.uint64),
}
_MASKS = {
    "integers": np.zeros(2 * N, dtype=int),
    "None": None,
    "short": np.zeros(2 * N - 1, dtype=bool),
    "ragged": [[True], [True, False]],
}


def _wrong_arrays():
    yield from each("load", lambda v: discrete(load=v), _arrays((2 * N,)))
    yield from each("solve start", started, _arrays((25, 2)), ("complex", "short"))
    yield from each("ContactNodes nodes", lambda v: discrete(contact=contact(nodes=v)), _INTEGERS)
    yield from each("fixed", lambda v: discrete(fixed=v), _MASKS)
    for make, names in (
        (discrete, "fixed_values coordinates near_nullspace"),
        (contact, "gaps slip_reference normals weights"),
    ):
        yield from words(make, names, [1j])
    for make, name, *values in (
        (discrete, "coordinates", 1e200 * np.random.default_rng(0).random((N, 2))),
        (discrete, "near_nullspace", np.ones((2 * N, 0)), sparse.csr_array((2 * N, 1))),
        (contact, "normals", [[0, 1e200], [0, 1]]),
        (contact, "weights", [1e-320, 1.0]),
    ):
        yield from each(f"wild {name}", lambda v, m=make, n=name: m(**{n: v}), labelled(values))
    yield from words(contact, "boundary", [0.5, 0.0], np.array([2**32, 0]), names=("a", "b"))


def _wrong_matrices():
    yield from words(
        discrete,
        "matrix",
        matrix().astype(bool),
        np.eye(2 * N),
        sparse.coo_array(np.ones(24)),
        sparse.csr_array((0, 0)),
        sparse.eye_array(23).tocsr(),
    )
    yield from words(
        coupled,
        "weights",
        np.eye(N),
        sparse.csr_array(np.roll(np.eye(N), 1, axis=0)),
        sparse.csr_array((N + 1, N + 1)),
    )
    yield from each(
        "prolongations",
        lambda v: am.Hierarchy.from_prolongations(discrete(), v),
        labelled(
            (
                sparse.csr_array((5, 3)),
                [halved(), sparse.csr_array(np.ones((6, 3)))],
                [],
                [sparse.eye_array(N)],
            )
        ),
    )
    yield from each(
        "prolongations[0]",
        coarse,
        labelled(
            (
                np.ones((N, 3)),
                1j * halved(),
                1e200 * halved(),
                1e-300 * halved(),
                sparse.csr_array((N, 0)),
            )
        ),
    )
    yield from each(
        "max_coarse", lambda v: am.Hierarchy.algebraic(discrete(), max_coarse=v), {"all nodes": N}
    )
    yield from words(level, "prolongation", np.ones((25, 9)), 1j * sparse.eye_array(25, 9).tocsr())
    yield from words(am.Level, "galerkin", sparse.eye_array(4).tocsr(), discrete=None)
    for name, *values in (
        ("prolongation", None, short := sparse.eye_array(49, 18).tocsr()),
        ("surface_prolongation", short),
    ):
        yield from each(
            f"levels[1].{name}", lambda v, n=name: two_levels(**{n: v}), labelled(values)
        )


def _unsymmetric_block():
    """A soft block 32 % unsymmetric next to a stiff one."""
    value = sparse.lil_array(sparse.block_diag([1e12 * matrix(), matrix()]))
    value[2 * N, 2 * N + 2] *= 1.32
    return sparse.csr_array(value)


def _solved(**changes):
    return am.solve(discrete(**changes))


INPUTS = (
    *_broken_matrices(),
    *_wrong_arrays(),
    *_wrong_matrices(),
    Hostile(
        "matrix of blocks of three",
        lambda: discrete(matrix=sparse.bsr_array(matrix(), blocksize=(3, 3)), load=np.ones(23)),
        "load",
    ),
    Hostile(
        "soft unsymmetric block",
        lambda: discrete(
            matrix=_unsymmetric_block(), load=np.ones(4 * N), fixed=np.zeros(4 * N, dtype=bool)
        ),
        "symmetric",
    ),
    *words(_solved, "matrix", 1e200 * matrix(), 1e-300 * matrix()),
    *words(_solved, "load", np.full(2 * N, 1e300)),
    *each(
        "solved gaps",
        lambda v: _solved(contact=contact(gaps=v, allow_interference=True)),
        {"1e300": [-1e300, 0.0]},
    ),
    *each("start", started, {"1e300": np.full((25, 2), 1e300)}),
    Hostile(
        "near_nullspace zero",
        lambda: am.Hierarchy.algebraic(discrete(near_nullspace=np.zeros((2 * N, 2))), max_coarse=4),
        "near_nullspace",
    ),
    *words(coupled, "near_nullspace", np.ones((3, 1))),
    *each("probe points", lambda v: am.solve(grids()).probe(v), {"complex": [[1j, 0.0]]}),
    *each(
        "resultant about",
        lambda v: am.solve(grids()).resultant("contact", about=v),
        {"text": ["0", "0"]},
    ),
)
