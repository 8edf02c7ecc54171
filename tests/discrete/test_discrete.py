"""DiscreteProblem, ContactNodes and relative coordinates: what they make of arrays, inverses,
duals, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refused import refused
from scipy import sparse

import adaptmg as am
from adaptmg.discrete.coordinates import Coupling
from adaptmg.discrete.supports import Inclined


def contact(**changes: object) -> am.ContactNodes:
    arguments = {"nodes": [0, 2], "normals": [[0.0, -1.0], [0.6, -0.8]], "gaps": [0.0, 0.1]}
    return am.ContactNodes(**(arguments | changes))


def discrete(**changes: object) -> am.DiscreteProblem:
    arguments = {
        "matrix": sparse.eye_array(6).tocsr(),
        "load": np.zeros(6),
        "fixed": np.zeros(6, dtype=bool),
        "law": am.Frictionless(),
        "contact": contact(),
    }
    return am.DiscreteProblem(**(arguments | changes))


def test_arrays_are_read_only_copies_with_defaults():
    gaps = np.array([0.0, -1e-3])
    nodes = contact(gaps=gaps, allow_interference=True, normals=[[0.0, -1.0 - 5e-7], [0.6, -0.8]])
    gaps[0] = 5.0
    assert len(nodes) == 2 and nodes.dim == 2 and nodes.gaps.tolist() == [0.0, -1e-3]
    np.testing.assert_array_equal(nodes.weights, 1.0)
    assert not nodes.slip_reference.any() and not nodes.boundary.any()
    np.testing.assert_allclose(np.linalg.norm(nodes.normals, axis=1), 1.0, rtol=1e-15)
    for array in (nodes.gaps, nodes.normals):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"nodes": [2, 2]}, ValueError, "distinct"),
        (
            {"normals": [[0.0, np.nan], [0.6, -0.8]]},
            ValueError,
            "normals must be finite; 1 entries are not",
        ),
        ({"normals": [[0.0, -1.0], [0.6, -0.9]]}, ValueError, "contact node 1 has length 1.08"),
        (
            {"gaps": [0.0, -1e-3]},
            ValueError,
            "got -0.001 at contact node 1; for an interference fit",
        ),
        ({"weights": [1.0, 0.0]}, ValueError, "weights must be > 0"),
        ({"boundary": [0, 1]}, ValueError, "boundary must index names"),
    ],
)
def test_wrong_contact_nodes_are_refused(changes, error, message):
    with pytest.raises(error, match=message):
        contact(**changes)


def test_what_a_problem_makes_of_its_arrays():
    points, own = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.ones((6, 1))
    fixed = np.array([True, False, True, False, False, False])  # a fixed tangent is fine
    rounding = (sparse.eye_array(6) + sparse.eye_array(6, k=1) * 1e-12).tocsr()
    problem = discrete(
        matrix=rounding, fixed=fixed, fixed_values=np.arange(1.0, 7.0), coordinates=points
    )
    assert problem.matrix.format == "bsr" and problem.matrix.blocksize == (2, 2)
    assert (problem.n_nodes, problem.n_dofs, problem.dim) == (3, 6, 2)
    np.testing.assert_array_equal(problem.fixed_values, [1, 0, 3, 0, 0, 0])
    assert problem.near_nullspace.shape == (6, 3) and discrete().near_nullspace is None
    np.testing.assert_array_equal(
        discrete(coordinates=points, near_nullspace=own).near_nullspace, own
    )


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"matrix": sparse.csr_array((6, 6))}, ValueError, "matrix is zero"),
        (
            {"matrix": sparse.diags_array([1, 1, 1, -1, 1, 1.0]).tocsr()},
            ValueError,
            r"entry 3 \(node 1\) is -1",
        ),
        (
            {"matrix": (sparse.eye_array(6) + sparse.eye_array(6, k=1) * 1e-3).tocsr()},
            ValueError,
            "must be symmetric",
        ),
        ({"law": am.Coulomb(np.ones(3))}, ValueError, "array over the 2 contact nodes"),
        ({"law": am.Tresca(lambda x: x[:, 0])}, TypeError, "evaluated at the nodes first"),
        (
            {"contact": contact(nodes=[0, 3])},
            ValueError,
            "node 3 does not exist; there are 3 nodes",
        ),
        (
            {"fixed": np.array([False, True, False, False, False, False])},
            ValueError,
            "normal part is fixed",
        ),
        (
            {"fixed": np.array([False, False, False, False, True, False])},
            ValueError,
            "contact node 1",
        ),
    ],
)
def test_wrong_problems_are_refused(changes, error, message):
    with pytest.raises(error, match=message):
        discrete(**changes)


# -- relative coordinates: against dense algebra -----------------------------------------------------------------------

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)


def chained(rng, links=2, n=4, bodies=None):
    """Weights of ``links`` + 1 groups of n nodes: most nodes of a group follow nodes of the next,
    some are negative."""
    bodies = links + 1 if bodies is None else bodies
    weights = np.zeros((bodies * n, bodies * n))
    for k in range(links):
        for i in range(n - 1):
            chosen = (k + 1) * n + rng.choice(n, size=rng.integers(1, n), replace=False)
            row = rng.normal(size=len(chosen))
            row += (1 - row.sum()) / len(row)
            weights[k * n + i, chosen] = row
    order = rng.permutation(len(weights))
    return sparse.csr_array(weights[order][:, order])


def dense(coupling):
    """T (n_dofs, n_dofs), from its definition (I - Pi W)^-1."""
    W = np.kron(coupling.weights.toarray(), np.eye(coupling.dim)) * ~coupling.fixed[:, None]
    return np.linalg.inv(np.eye(len(W)) - W)


def made(seed, links=2, dim=2, share=0.2):
    rng = np.random.default_rng(seed)
    weights = chained(rng, links)
    fixed = rng.random(dim * weights.shape[0]) < share
    return Coupling(weights, fixed, Inclined.none(dim)), rng


@given(seed=SEEDS, links=st.integers(1, 4), dim=st.sampled_from([2, 3]))
@settings(max_examples=40, deadline=None)
def test_physical_and_relative_coordinates(seed, links, dim):
    coupling, rng = made(seed, links, dim)
    T = dense(coupling)
    assert coupling.dim == dim
    for shape in ((len(T),), (len(T), 3)):
        w, f = rng.normal(size=(2, *shape))
        size = np.abs(T).max()
        np.testing.assert_allclose(coupling.physical(w), T @ w, atol=1e-12 * size**2)
        np.testing.assert_allclose(coupling.relative(coupling.physical(w)), w, atol=1e-12 * size**2)
        np.testing.assert_allclose(coupling.physical(coupling.relative(w)), w, atol=1e-12 * size**2)
        np.testing.assert_allclose(coupling.relative_forces(f), T.T @ f, atol=1e-12 * size**2)
        np.testing.assert_allclose(
            coupling.physical_forces(coupling.relative_forces(f)), f, atol=1e-12 * size**2
        )
    # work does not depend on the coordinates
    assert coupling.relative_forces(f).ravel() @ w.ravel() == pytest.approx(
        f.ravel() @ coupling.physical(w).ravel(), abs=1e-10 * size**2
    )
    np.testing.assert_allclose(
        coupling.upward.toarray(),
        np.linalg.inv(np.eye(len(T) // dim) - coupling.weights.toarray()),
        atol=1e-12 * np.abs(coupling.upward).max() ** 2,
    )


def coupled(weights=(0.5, 0.5), fixed=(0, 1), **parts):
    """Two chains of three nodes; node 3 (slave) faces nodes 1 and 2."""
    link = np.array([[1.0, -1.0], [-1.0, 1.0]])
    chain = np.zeros((6, 6))
    for i, j in ((0, 1), (1, 2), (3, 4), (4, 5)):
        chain[np.ix_([i, j], [i, j])] += link
    problem = am.DiscreteProblem(
        matrix=sparse.csr_array(np.kron(chain, np.eye(2))),
        load=np.arange(12.0),
        law=am.Frictionless(),
        fixed=np.isin(np.arange(12), fixed),
        **parts,
        contact=am.ContactNodes(
            nodes=np.array([3]), normals=[[0.0, 1.0]], gaps=[0.1], masters=("other",)
        ),
    )
    return problem.coupled(sparse.csr_array((weights, ([3, 3], [1, 2])), shape=(6, 6)))


def test_rigid_motions_are_those_of_displacements():
    points = np.array([[0, 0], [0, 1], [1, 1], [0.3, 1], [0, 2], [1, 2.0]])
    problem = coupled(coordinates=points)
    turn = np.column_stack([-points[:, 1], points[:, 0]]).ravel()
    fields = np.column_stack([problem.physical(mode).ravel() for mode in problem.near_nullspace.T])
    assert np.linalg.lstsq(fields, turn, rcond=None)[1] == pytest.approx(0, abs=1e-20)


def test_a_slave_may_be_fixed_along_the_surface():
    assert not coupled(fixed=(0, 1, 6)).coupling.physical(np.eye(12))[6, 2:6].any()


test_wrong_couplings_are_refused = refused(
    (
        lambda: replace(coupled(), fixed=np.zeros(12, dtype=bool)),
        r"other fixed dofs: use DiscreteProblem.coupled",
    ),
    (
        lambda: am.ContactNodes(
            nodes=np.array([3]), normals=[[0.0, 1.0]], gaps=[0.1], masters=("a", "b")
        ),
        "masters must go with names",
    ),
    (
        lambda: coupled(fixed=(7,)),
        r"normal part is fixed at contact node 0 \(node 3.*free the comp",
    ),
    (
        lambda: coupled().coupled(sparse.csr_array((6, 6))),
        "only a problem in displacements",
    ),
    (lambda: coupled((0.5, 0.4)), "sum 1, got 0.9 at node 3"),
    (lambda: coupled((0.5, np.nan)), "weights must be finite"),
    *(
        (
            lambda rows=rows, columns=columns, n=n: Coupling(
                sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)),
                np.zeros(2 * n, dtype=bool),
                Inclined.none(2),
            ),
            r"circle.*exchange slave and master",
        )
        for rows, columns, n in (
            ([0, 1, 2], [1, 2, 0], 4),
            ([0], [0], 3),
            ([0, 1], [1, 0], 2),
        )
    ),
)


@pytest.mark.parametrize("kind", ["pressure", "traction"])
def test_a_load_on_less_than_an_edge_that_integrates_to_zero_is_refused(kind):
    def solved(width):
        def patch(x):
            return 1e6 * (np.abs(x[:, 0] - 0.5) < width / 2)

        load = am.Pressure("top", patch)
        problem = am.ContactProblem(
            domain=am.Rectangle(width=1, height=1),
            material=am.PlaneStrain(young=1e9, poisson=0.3),
            loads=load if kind == "pressure" else am.Traction("top", (0.0, lambda x: -patch(x))),
            supports=am.Support("bottom", x=0, y=0),
        )
        return am.solve(am.Hierarchy.uniform(problem, (2, 4)))

    with pytest.raises(ValueError, match=r"on 'top' acts on less than an edge \(0\.25 m\)"):
        solved(0.1)
    assert solved(0.4).displacement.any() and not solved(0.0).displacement.any()
