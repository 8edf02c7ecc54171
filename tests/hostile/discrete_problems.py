"""DiscreteProblem, ContactNodes, couplings and coarse spaces from arrays and matrices that are broken."""

import numpy as np
from hostile_table import Hostile
from scipy import sparse

import adaptmg as am

_N = 12  # nodes of a chain
_FREE = np.zeros(2 * _N, dtype=bool)


def _matrix():
    """A block tridiagonal matrix, symmetric and positive definite."""
    chain = sparse.diags_array([-np.ones(_N - 1), 2.1 * np.ones(_N), -np.ones(_N - 1)], offsets=[-1, 0, 1])
    return sparse.csr_array(sparse.kron(chain, [[2.0, 0.5], [0.5, 1.0]]))


def _contact(**changes):
    return am.ContactNodes(**({"nodes": [0, 5], "normals": [[0.0, -1.0], [0.0, -1.0]], "gaps": [0.0, 0.1]} | changes))


def _discrete(**changes):
    parts = {"matrix": _matrix(), "load": np.ones(2 * _N), "fixed": _FREE, "law": am.Coulomb(0.3),
             "contact": _contact()}
    return am.DiscreteProblem(**(parts | changes))


def _solved(**changes):
    return am.solve(_discrete(**changes))


def _broken(matrix, part, change):
    """The matrix with one of its index arrays changed behind the constructor's back."""
    matrix = matrix.copy()
    setattr(matrix, part, change(getattr(matrix, part).copy()))
    return matrix


def _at(index, value):
    def change(array):
        array[index] = value
        return array
    return change


_BREAKS = {
    "index too large": ("indices", _at(3, 10_000_000)),
    "index negative": ("indices", _at(3, -5)),
    "index int64 overflow": ("indices", lambda a: _at(3, 2**40)(a.astype(np.int64))),
    "index 2**32": ("indices", lambda a: _at(3, 2**32)(a.astype(np.int64))),
    "indices short": ("indices", lambda a: a[:-4]),
    "indices float": ("indices", lambda a: a.astype(float)),
    "indptr falls": ("indptr", _at(3, 0)),
    "indptr beyond": ("indptr", _at(-1, 10_000_000)),
    "indptr begins at 1": ("indptr", _at(0, 1)),
    "indptr short": ("indptr", lambda a: a[:-2]),
    "indptr negative": ("indptr", _at(2, -7)),
    "indptr float": ("indptr", lambda a: a.astype(float)),
    "data short": ("data", lambda a: a[:-3]),
    "data complex": ("data", lambda a: a.astype(complex)),
    "data nan": ("data", _at(0, np.nan)),
    "data objects": ("data", lambda a: a.astype(object)),
    "data text": ("data", lambda a: a.astype(str)),
}


def _matrices():
    forms = {"csr": _matrix(), "bsr": sparse.bsr_array(_matrix(), blocksize=(2, 2)), "csc": sparse.csc_array(_matrix()),
             "csr_matrix": sparse.csr_matrix(_matrix())}
    for form, matrix in forms.items():
        for label, (part, change) in _BREAKS.items():
            yield Hostile(f"{form} {label}", lambda m=matrix, p=part, c=change: _discrete(matrix=_broken(m, p, c)),
                          "matrix")
    coo = sparse.coo_array(_matrix())
    yield Hostile("coo row", lambda: _discrete(matrix=_coo(coo, 0, 10_000_000)), "matrix")
    yield Hostile("coo column negative", lambda: _discrete(matrix=_coo(coo, 1, -3)), "matrix")
    nodal = _prolongation()
    for label, (part, change) in _BREAKS.items():
        yield Hostile(f"prolongation {label}", lambda p=part, c=change: am.Hierarchy.from_prolongations(
            _discrete(), [_broken(nodal, p, c)]), "prolongations[0]")
        yield Hostile(f"weights {label}", lambda p=part, c=change: _coupled(_broken(_weights(), p, c)), "weights")


def _coo(matrix, axis, value):
    matrix = matrix.copy()
    matrix.coords[axis][4] = value
    return matrix


def _prolongation():
    rows = np.arange(_N)
    return sparse.csr_array((np.ones(_N), (rows, rows // 2)), shape=(_N, _N // 2))


def _weights():
    return sparse.csr_array((np.full(6, 0.5), ([0, 0, 5, 5, 6, 6], [1, 2, 8, 9, 10, 11])), shape=(_N, _N))


def _coupled(weights, **changes):
    parts = {"matrix": _matrix(), "load": np.ones(2 * _N), "fixed": _FREE, "law": am.Coulomb(0.3),
             "contact": _contact(), "weights": weights}
    return am.DiscreteProblem.coupled(**(parts | changes))


def _unsymmetric_block():
    """A soft block 32 % unsymmetric beside a stiff one."""
    matrix = sparse.lil_array(sparse.block_diag([1e12 * _matrix(), _matrix()]))
    matrix[2 * _N, 2 * _N + 2] *= 1.32
    return sparse.csr_array(matrix)


class _Law(am.Coulomb):
    """Coulomb's law with bounds of one's own."""

    def __init__(self, bounds):
        object.__setattr__(self, "own", bounds)
        super().__init__(0.3)

    def bounds(self, n_contact):
        return self.own(n_contact)


def _laws():
    bounds = {
        "None": lambda n: None, "one array": lambda n: np.zeros(n), "three": lambda n: (np.zeros(n),) * 3,
        "short": lambda n: (np.zeros(n - 1), np.zeros(n)), "scalars": lambda n: (0.0, None),
        "text": lambda n: (np.zeros(n), np.full(n, "1")), "complex": lambda n: (np.zeros(n), np.full(n, 1j)),
        "nan": lambda n: (np.zeros(n), np.full(n, np.nan)), "negative": lambda n: (np.full(n, -1.0), np.zeros(n)),
        "column": lambda n: (np.zeros((n, 1)), np.zeros(n)), "bools": lambda n: (np.zeros(n), np.ones(n, dtype=bool)),
        "number": lambda n: 5.0, "infinite": lambda n: (np.full(n, np.inf), np.zeros(n)),
    }
    for label, own in bounds.items():
        yield Hostile(f"bounds {label}", lambda o=own: _discrete(law=_Law(o)), "law")


INPUTS = (
    *_matrices(), *_laws(),
    Hostile("matrix complex", lambda: _discrete(matrix=_matrix() * (1 + 0j)), "matrix"),
    Hostile("matrix bool", lambda: _discrete(matrix=_matrix().astype(bool)), "matrix"),
    Hostile("matrix text", lambda: _discrete(matrix="A"), "matrix"),
    Hostile("matrix None", lambda: _discrete(matrix=None), "matrix"),
    Hostile("matrix one-dimensional", lambda: _discrete(matrix=sparse.coo_array(np.ones(24))), "matrix"),
    Hostile("matrix empty", lambda: _discrete(matrix=sparse.csr_array((0, 0))), "matrix"),
    Hostile("matrix odd", lambda: _discrete(matrix=sparse.eye_array(23).tocsr()), "matrix"),
    Hostile("matrix blocks of three", lambda: _discrete(matrix=sparse.bsr_array(_matrix(), blocksize=(3, 3)),
                                                        load=np.ones(23)), "load"),
    Hostile("soft unsymmetric block", lambda: _discrete(
        matrix=_unsymmetric_block(), load=np.ones(4 * _N), fixed=np.zeros(4 * _N, dtype=bool)), "symmetric"),
    Hostile("matrix 1e200", lambda: _solved(matrix=1e200 * _matrix()), "matrix"),
    Hostile("matrix 1e-300", lambda: _solved(matrix=1e-300 * _matrix()), "matrix"),
    Hostile("load 1e300", lambda: _solved(load=np.full(2 * _N, 1e300)), "load"),
    Hostile("load complex", lambda: _discrete(load=np.full(2 * _N, 1j)), "load"),
    Hostile("load text", lambda: _discrete(load=["1"] * 2 * _N), "load"),
    Hostile("load bool", lambda: _discrete(load=np.ones(2 * _N, dtype=bool)), "load"),
    Hostile("load None", lambda: _discrete(load=None), "load"),
    Hostile("load column", lambda: _discrete(load=np.ones((2 * _N, 1))), "load"),
    Hostile("fixed integers", lambda: _discrete(fixed=np.zeros(2 * _N, dtype=int)), "fixed"),
    Hostile("fixed None", lambda: _discrete(fixed=None), "fixed"),
    Hostile("fixed short", lambda: _discrete(fixed=_FREE[:-1]), "fixed"),
    Hostile("fixed ragged", lambda: _discrete(fixed=[[True], [True, False]]), "fixed"),
    Hostile("fixed_values text", lambda: _discrete(fixed_values=["0"] * 2 * _N), "fixed_values"),
    Hostile("fixed_values complex", lambda: _discrete(fixed_values=np.full(2 * _N, 1j)), "fixed_values"),
    Hostile("fixed_values None list", lambda: _discrete(fixed_values=[None] * 2 * _N), "fixed_values"),
    Hostile("coordinates text", lambda: _discrete(coordinates=np.full((_N, 2), "0")), "coordinates"),
    Hostile("coordinates nan", lambda: _discrete(coordinates=np.full((_N, 2), np.nan)), "coordinates"),
    Hostile("coordinates 1e200", lambda: _discrete(coordinates=1e200 * np.random.default_rng(0).random((_N, 2))),
            "coordinates"),
    Hostile("near_nullspace complex", lambda: _discrete(near_nullspace=np.full((2 * _N, 1), 1j)), "near_nullspace"),
    Hostile("near_nullspace flat", lambda: _discrete(near_nullspace=np.ones(2 * _N)), "near_nullspace"),
    Hostile("near_nullspace sparse", lambda: _discrete(near_nullspace=sparse.csr_array(np.ones((2 * _N, 1)))),
            "near_nullspace"),
    Hostile("near_nullspace empty", lambda: _discrete(near_nullspace=np.ones((2 * _N, 0))), "near_nullspace"),
    Hostile("near_nullspace zero", lambda: am.Hierarchy.algebraic(
        _discrete(near_nullspace=np.zeros((2 * _N, 2))), max_coarse=4), "near_nullspace"),
    Hostile("name number", lambda: _discrete(name=5), "name"),
    Hostile("coupling text", lambda: _discrete(coupling="W"), "coupling"),
    Hostile("bodies list", lambda: _discrete(bodies=[0, 1]), "bodies"),
    Hostile("bodies out of range", lambda: _discrete(bodies={"a": np.array([0, 99])}), "bodies"),
    Hostile("bodies of floats", lambda: _discrete(bodies={"a": np.array([0.5])}), "bodies"),
    Hostile("law class", lambda: _discrete(law=am.Coulomb), "law"),
    Hostile("law of text", lambda: _discrete(law="Coulomb"), "law"),
    Hostile("contact class", lambda: _discrete(contact=am.ContactNodes), "contact"),
    Hostile("nodes of floats", lambda: _contact(nodes=[0.0, 5.0]), "nodes"),
    Hostile("nodes wrapped", lambda: _discrete(contact=_contact(nodes=np.array([0, 2**32 + 5]))), "nodes"),
    Hostile("nodes uint64", lambda: _contact(nodes=np.array([0, 2**64 - 3], dtype=np.uint64)), "nodes"),
    Hostile("nodes bools", lambda: _contact(nodes=[True, False]), "nodes"),
    Hostile("nodes text", lambda: _contact(nodes=["0", "5"]), "nodes"),
    Hostile("nodes None", lambda: _contact(nodes=None), "nodes"),
    Hostile("nodes one number", lambda: _contact(nodes=5), "nodes"),
    Hostile("nodes ragged", lambda: _contact(nodes=[[0], [1, 2]]), "nodes"),
    Hostile("nodes masked", lambda: _contact(nodes=np.ma.masked_array([0, 5], mask=[0, 1])), "nodes"),
    Hostile("nodes huge", lambda: _contact(nodes=[0, 10**30]), "nodes"),
    Hostile("nodes mask", lambda: _contact(nodes=np.arange(_N) < 2), "nodes"),
    Hostile("normals text", lambda: _contact(normals=[["0", "-1"], ["0", "-1"]]), "normals"),
    Hostile("normals complex", lambda: _contact(normals=np.array([[0, -1], [0, -1 + 0j]])), "normals"),
    Hostile("normals None", lambda: _contact(normals=None), "normals"),
    Hostile("normals infinite", lambda: _contact(normals=[[np.inf, 0], [0, 1]]), "normals"),
    Hostile("normals 1e200", lambda: _contact(normals=[[0, 1e200], [0, 1]]), "normals"),
    Hostile("gaps text", lambda: _contact(gaps=["0", "0"]), "gaps"),
    Hostile("gaps complex", lambda: _contact(gaps=[0j, 0j]), "gaps"),
    Hostile("gaps bool", lambda: _contact(gaps=[False, False]), "gaps"),
    Hostile("gaps None", lambda: _contact(gaps=None), "gaps"),
    Hostile("gaps 1e300", lambda: _solved(contact=_contact(gaps=[-1e300, 0.0], allow_interference=True)), "gaps"),
    Hostile("interference text", lambda: _contact(gaps=[-1.0, 0.0], allow_interference="no"), "allow_interference"),
    Hostile("weights complex", lambda: _contact(weights=[1j, 1j]), "weights"),
    Hostile("weights text", lambda: _contact(weights=["1", "1"]), "weights"),
    Hostile("weights tiny", lambda: _contact(weights=[1e-320, 1.0]), "weights"),
    Hostile("slip_reference complex", lambda: _contact(slip_reference=np.full((2, 2), 1j)), "slip_reference"),
    Hostile("boundary floats", lambda: _contact(boundary=[0.5, 0.0]), "boundary"),
    Hostile("boundary wrapped", lambda: _contact(boundary=np.array([2**32, 0])), "boundary"),
    Hostile("boundary bools", lambda: _contact(boundary=[False, True], names=("a", "b")), "boundary"),
    Hostile("names letters", lambda: _contact(names="contact"), "names"),
    Hostile("names None", lambda: _contact(names=None), "names"),
    Hostile("names numbers", lambda: _contact(names=(1,)), "names"),
    Hostile("names empty", lambda: _contact(names=()), "names"),
    Hostile("names contact of several", lambda: _discrete(
        contact=_contact(names=("a", "contact"), boundary=[0, 1])), "'contact'"),
    Hostile("masters contact", lambda: _coupled(_weights(), contact=_contact(names=("a",), masters=("contact",))),
            "'contact'"),
    Hostile("coupled bounds None", lambda: _coupled(_weights(), law=_Law(lambda n: None)), "law"),
    Hostile("names surrogate", lambda: _contact(names=("\ud800",)), "names"),
    Hostile("masters letters", lambda: _contact(masters="m"), "masters"),
    Hostile("masters numbers", lambda: _contact(masters=(1,)), "masters"),
    Hostile("masters None inside", lambda: _contact(masters=(None,)), "masters"),
    # couplings
    Hostile("weights dense", lambda: _coupled(np.eye(_N)), "weights"),
    Hostile("weights None", lambda: _coupled(None), "weights"),
    Hostile("weights complex matrix", lambda: _coupled(_weights() * 1j), "weights"),
    Hostile("weights circle", lambda: _coupled(sparse.csr_array(np.roll(np.eye(_N), 1, axis=0))), "weights"),
    Hostile("weights of another size", lambda: _coupled(sparse.csr_array((_N + 1, _N + 1))), "weights"),
    Hostile("coupled matrix dense", lambda: _coupled(_weights(), matrix=np.eye(2 * _N)), "matrix"),
    Hostile("coupled matrix broken", lambda: _coupled(
        _weights(), matrix=_broken(_matrix(), *_BREAKS["index too large"])), "matrix"),
    Hostile("coupled matrix small", lambda: _coupled(_weights(), matrix=sparse.eye_array(6).tocsr()), "matrix"),
    Hostile("coupled load complex", lambda: _coupled(_weights(), load=np.full(2 * _N, 1j)), "load"),
    Hostile("coupled load short", lambda: _coupled(_weights(), load=np.ones(3)), "load"),
    Hostile("coupled coordinates text", lambda: _coupled(_weights(), coordinates="x"), "coordinates"),
    Hostile("coupled coordinates short", lambda: _coupled(_weights(), coordinates=np.zeros((3, 2))), "coordinates"),
    Hostile("coupled near_nullspace short", lambda: _coupled(_weights(), near_nullspace=np.ones((3, 1))),
            "near_nullspace"),
    Hostile("coupled fixed None", lambda: _coupled(_weights(), fixed=None), "fixed"),
    Hostile("coupled contact None", lambda: _coupled(_weights(), contact=None), "contact"),
    Hostile("coupled law class", lambda: _coupled(_weights(), law=am.Coulomb), "law"),
    # coarse spaces
    Hostile("prolongations None", lambda: am.Hierarchy.from_prolongations(_discrete(), None), "prolongations"),
    Hostile("prolongations one matrix", lambda: am.Hierarchy.from_prolongations(
        _discrete(), sparse.csr_array((5, 3))), "prolongations"),
    Hostile("prolongations dense", lambda: am.Hierarchy.from_prolongations(_discrete(), [np.ones((_N, 3))]),
            "prolongations[0]"),
    Hostile("prolongations text", lambda: am.Hierarchy.from_prolongations(_discrete(), "P"), "prolongations"),
    Hostile("prolongations complex", lambda: am.Hierarchy.from_prolongations(_discrete(), [1j * _prolongation()]),
            "prolongations[0]"),
    Hostile("prolongations of a class", lambda: am.Hierarchy.from_prolongations(am.DiscreteProblem, [_prolongation()]),
            "discrete"),
    Hostile("prolongations of None", lambda: am.Hierarchy.from_prolongations(None, [_prolongation()]), "discrete"),
    Hostile("prolongations of a matrix", lambda: am.Hierarchy.from_prolongations(_matrix(), [_prolongation()]),
            "discrete"),
    Hostile("prolongations zero", lambda: am.Hierarchy.from_prolongations(_discrete(), [0 * _prolongation()]),
            "prolongations[0]"),
    Hostile("prolongations 1e200", lambda: am.Hierarchy.from_prolongations(_discrete(), [1e200 * _prolongation()]),
            "prolongations[0]"),
    Hostile("prolongations 1e-300", lambda: am.Hierarchy.from_prolongations(_discrete(), [1e-300 * _prolongation()]),
            "prolongations[0]"),
    Hostile("prolongations without columns", lambda: am.Hierarchy.from_prolongations(
        _discrete(), [sparse.csr_array((_N, 0))]), "prolongations[0]"),
    Hostile("prolongations fine to coarse", lambda: am.Hierarchy.from_prolongations(
        _discrete(), [_prolongation(), sparse.csr_array(np.ones((6, 3)))]), "prolongations"),
    Hostile("algebraic class", lambda: am.Hierarchy.algebraic(am.DiscreteProblem), "discrete"),
    Hostile("algebraic strength text", lambda: am.Hierarchy.algebraic(_discrete(), strength="0"), "strength"),
    Hostile("algebraic max_coarse float", lambda: am.Hierarchy.algebraic(_discrete(), max_coarse=5.0), "max_coarse"),
    Hostile("single None", lambda: am.Hierarchy.single(None), "discrete"),
    Hostile("single matrix", lambda: am.Hierarchy.single(_matrix()), "discrete"),
)
