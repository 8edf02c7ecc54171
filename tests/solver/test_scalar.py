"""Scalar problems between obstacles: against bounded least squares, closed forms, and each other."""

from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import lsq_linear

import adaptmg as am

TIGHT = {"rtol": 1e-11}
UNCHANGED = SimpleNamespace(project=lambda contact, before, after: after)
METHODS = {
    "nested": am.FullMultigrid(**TIGHT),
    "from zero": am.Multigrid(**TIGHT),
    "monotone": am.Multigrid(correction=am.Monotone(), max_cycles=300, **TIGHT),
    "monotone nested": am.FullMultigrid(correction=am.Monotone(), max_cycles=300, **TIGHT),
    "sweeps": am.SingleGrid(**TIGHT),
    "active set": am.ActiveSet(),
    "sparse active set": am.ActiveSet(condensed=False),
    "pyamg": am.FullMultigrid(correction=am.Truncated(correct=am.PyAMG()), **TIGHT),
    "user-defined": am.FullMultigrid(
        correction=am.Truncated(smooth=am.ProjectedGaussSeidel(), project=UNCHANGED), **TIGHT
    ),
}


def membrane(seed: int, two_sided: bool) -> am.Hierarchy:
    """Return grids of a membrane under a load of both signs, over a floor and perhaps under a
    ceiling, neither of which is flat."""
    rng = np.random.default_rng(seed)
    size, waves = 10.0 ** rng.uniform(-2, 2), rng.uniform(2, 6, 4)
    problem = am.ScalarProblem(
        domain=am.Rectangle(width=size, height=size),
        conductivity=lambda x: 1 + 0.5 * np.sin(waves[0] * x[:, 0] / size),
        load=lambda x: 80 / size**2 * np.cos(waves[1] * x[:, 0] / size - waves[2] * x[:, 1] / size),
        lower=lambda x: -0.5 + 0.1 * np.sin(waves[3] * x[:, 1] / size),
        upper=(lambda x: 0.3 + 0.1 * np.cos(waves[3] * x[:, 0] / size)) if two_sided else None,
        value=lambda x: 0.2 * x[:, 0] / size,
    )
    return am.Hierarchy.uniform(problem, divisions=(4, 8, 16))


def bounded_least_squares(problem: am.DiscreteProblem) -> np.ndarray:
    """Return the solution (n_nodes,): the least |L'u - L^-1 b| within the bounds, A = LL'."""
    lower, upper = np.full((2, problem.n_nodes), np.inf)
    contact = problem.contact
    up = contact.normals[:, 0] > 0
    upper[contact.nodes] = np.where(up, contact.gaps, contact.opposite_gaps)
    lower[contact.nodes] = np.where(up, contact.opposite_gaps, contact.gaps)
    free = ~problem.fixed
    A = problem.matrix.toarray()
    L = np.linalg.cholesky(A[np.ix_(free, free)])
    b = (problem.load - A @ problem.fixed_values)[free]
    bounds = -lower[free], upper[free]
    found = lsq_linear(L.T, np.linalg.solve(L, b), bounds, method="bvls", tol=1e-15, max_iter=5000)
    result = problem.fixed_values.copy()
    result[free] = found.x
    return result


@pytest.mark.parametrize("two_sided", [False, True])
def test_all_methods_agree_with_bounded_least_squares(two_sided):
    grids = membrane(4 + two_sided, two_sided)
    exact = bounded_least_squares(grids.finest.discrete)
    size = np.abs(exact).max()
    touching = None
    for name, solver in METHODS.items():
        result = am.solve(grids, solver)
        assert np.abs(result.displacement[:, 0] - exact).max() < 1e-9 * size, name
        contact = result.contact
        assert (contact.gap >= 0).all() and (contact.force_n >= 0).all()
        touching = contact.closed if touching is None else touching
        assert (contact.closed == touching).all(), name
        assert 20 < touching.sum() < len(contact) - 20, name
        assert result.certificate().energy_error < 1e-7
        if two_sided:
            sides = contact.normal[contact.closed, 0]
            assert {-1.0, 1.0} == set(sides.tolist())


def energy(problem, u):
    return 0.5 * u @ (problem.matrix @ u) - problem.load @ u


def test_the_energy_of_monotone_falls_in_each_cycle():
    grids = membrane(9, True)
    problem = grids.finest.discrete
    falls = []
    for cycles in range(1, 12):
        solver = am.Multigrid(correction=am.Monotone(), max_cycles=cycles, rtol=1e-14)
        u = am.solve(grids, solver, throw=False).displacement[:, 0]
        falls.append(energy(problem, u))
    assert (np.diff(falls) < 0).all() and falls[0] - falls[-1] > 1e-3 * abs(falls[-1])


@pytest.mark.parametrize("divisions", [64, 128])
def test_cycles_stay_few_on_fine_grids_where_all_nodes_may_touch(divisions):
    def roof(x):
        return np.minimum(x, 1 - x).min(axis=1)

    problem = am.ScalarProblem(
        domain=am.Rectangle(width=1.0, height=1.0), load=5.0, lower=lambda x: -roof(x), upper=roof
    )
    grids = am.Hierarchy.uniform(problem, [2**k for k in range(2, divisions.bit_length())])
    assert am.solve(grids).cycles <= 8
    cold = am.solve(grids, am.Multigrid())
    assert cold.cycles <= 10 and not cold.fallback


def test_a_round_membrane_lies_on_its_floor_as_in_the_closed_form():
    radius, tension, load, depth = 0.3, 7.0, 500.0, 0.5
    problem = am.cases.obstacle_problem(radius=radius, tension=tension, load=load, depth=depth)
    grids = am.Hierarchy.graded(problem, [radius * h for h in (0.2, 0.1, 0.05)])
    a = problem.reference["contact_radius"]
    missed = []
    for finest in (1, 2):
        result = am.solve(grids.truncated(finest=finest))
        exact = problem.reference["deflection"](result.mesh.points)
        missed.append(np.abs(result.displacement[:, 0] - exact).max() / depth)
    assert missed[1] < 5e-3 and missed[1] < 0.4 * missed[0]  # of second order
    assert exact[np.linalg.norm(result.mesh.points, axis=1) < a] == pytest.approx(-depth)
    assert result.resultant().force[0] == pytest.approx(np.pi * load * a**2, rel=2e-3)
    assert result.max_pressure == pytest.approx(load, rel=1e-9)
    assert result.probe([(0.0, 0.0), (0.0, a / 2)]) == pytest.approx(-depth)


def test_a_round_bar_yields_outside_of_the_elastic_radius():
    problem = am.cases.elastic_plastic_torsion(size=2.0, shear=3.0, twist=0.5, yield_stress=2.0)
    assert problem.reference["elastic_radius"] == pytest.approx(4 / 3)
    grids = am.Hierarchy.graded(problem, (0.4, 0.2, 0.1))
    result, mesh = am.solve(grids), grids.finest.mesh
    torque = 2 * (mesh.volumes * result.displacement[mesh.elements, 0].mean(axis=1)).sum()
    assert torque == pytest.approx(problem.reference["torque"], rel=2e-3)
    r = np.linalg.norm(mesh.points[result.contact.node], axis=1)
    assert (result.contact.closed == (r > 4 / 3))[np.abs(r - 4 / 3) > 0.1].all()
    assert (result.contact.normal[result.contact.closed] == 1.0).all()


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_cycles_end_by_the_residual_where_coarse_levels_have_nothing_to_correct(size):
    """In a bar that yields everywhere except at its diagonals coarse corrections are rounding. From 7e-8
    after four cycles on, smoothing reduces the residual to two thirds in a cycle."""
    bar = am.cases.elastic_plastic_torsion(section="square", size=size, twist=5.0 / size)
    grids = am.Hierarchy.uniform(bar, divisions=(5, 10, 20))
    result = am.solve(grids, am.FullMultigrid())
    exact = am.solve(grids, am.ActiveSet())
    assert result.displacement == pytest.approx(exact.displacement, abs=1e-8 * size)
    assert result.cycles <= 12


@pytest.mark.parametrize("twist", [0.5, 1.0, 2.0, 4.0])
def test_a_square_bar_bears_its_torque(twist):
    """Elastic in closed form: .1406 G theta (2 a)^4; in part plastic against computed values."""
    size, shear, limit = 0.3, 7.0, 5.0
    problem = am.cases.elastic_plastic_torsion(
        section="square",
        size=size,
        shear=shear,
        twist=twist * limit / (shear * size),
        yield_stress=limit,
    )
    found = []
    for n in (32, 64):
        mesh = am.mesh.structured(problem.domain, n)
        grids = am.Hierarchy.uniform(problem, divisions=(n // 4, n // 2, n))
        result = am.solve(grids, am.FullMultigrid(rtol=1e-8))
        found.append(2 * mesh.volumes @ result.displacement[mesh.elements, 0].mean(axis=1))
    torque = problem.reference["torque"]
    assert (4 * found[1] - found[0]) / 3 == pytest.approx(torque, rel=2e-4)
    if twist == 0.5:
        assert torque == pytest.approx(
            0.1406 * shear * twist * limit / (shear * size) * (2 * size) ** 4, rel=5e-4
        )
        # the integral of |grad phi|^2 / 2 is that of G theta phi
        assert result.energy == pytest.approx(twist * limit / size * torque / 2, rel=2e-3)
    assert "torque" not in am.cases.elastic_plastic_torsion(section="square", twist=3.0).reference


@pytest.mark.parametrize("made", ["prolongations", "aggregates"])
def test_coarse_spaces_of_a_bare_matrix_take_restricted_obstacles(made):
    grids = membrane(3, True)
    problem = grids.finest.discrete
    exact = am.solve(grids, am.ActiveSet()).displacement
    if made == "prolongations":
        rows = [level.prolongation for level in grids.levels[1:]]
        spaces = am.Hierarchy.from_prolongations(problem, rows, contact=True)
        # nodes of stored zeros follow nothing
        full = [sparse.csr_array(np.ones(P.shape)) for P in rows]
        for P, zeros in zip(rows, full, strict=True):
            zeros.data[:] = P.toarray().reshape(-1)
        padded = am.Hierarchy.from_prolongations(problem, full, contact=True)
        for level, expected in zip(padded.levels, spaces.levels, strict=True):
            contact = level.discrete.contact
            np.testing.assert_array_equal(contact.nodes, expected.discrete.contact.nodes)
            np.testing.assert_allclose(contact.gaps, expected.discrete.contact.gaps)
    else:
        spaces = am.Hierarchy.algebraic(problem, max_coarse=20, contact=True)
    rng = np.random.default_rng(0)
    for above, below in zip(spaces.levels[:0:-1], spaces.levels[-2::-1], strict=True):
        # whatever is admissible below is so above
        inside = np.zeros(below.n_nodes)
        coarse, fine = below.discrete.contact, above.discrete.contact
        up = rng.random(len(coarse)) < 0.5
        inside[coarse.nodes] = np.where(up, coarse.gaps, -coarse.opposite_gaps)
        lifted = above.prolong(inside)[fine.nodes]
        assert (lifted <= fine.gaps + 1e-12).all() and (lifted >= -fine.opposite_gaps - 1e-12).all()
        assert np.isfinite(inside).all() and inside.any()
    for name in ("nested", "from zero", "monotone nested"):
        result = am.solve(spaces, METHODS[name])
        assert np.abs(result.displacement - exact).max() < 1e-9, name


def test_a_membrane_without_edges_rests_on_its_floor():
    problem = am.ScalarProblem(
        domain=am.Rectangle(width=1.0, height=2.0),
        load=lambda x: -1.0 - 3 * np.cos(7 * x[:, 0]),
        lower=lambda x: 0.1 * x[:, 1],
        held=(),
    )
    grids = am.Hierarchy.uniform(problem, (4, 8, 16))
    exact = am.solve(grids, am.ActiveSet()).displacement
    result = am.solve(grids)
    assert np.abs(result.displacement - exact).max() < 1e-7
    assert result.contact.force_n.sum() == pytest.approx(-grids.finest.discrete.load.sum())
    with pytest.raises(ValueError, match=r"nothing holds a constant.*prescribe values"):
        am.solve(am.Hierarchy.uniform(replace(problem, load=1.0), (4, 8)))


def test_bounds_of_a_body_are_contact_nodes():
    problem = am.cases.greco_bar(law=am.Frictionless())
    discrete = am.discretise(problem, am.mesh.structured(problem.domain, 4))
    lower = np.full((discrete.n_nodes, 2), -np.inf)
    lower[discrete.contact.nodes, 1] = -discrete.contact.gaps
    bounded = am.DiscreteProblem(
        matrix=discrete.matrix,
        load=discrete.load,
        fixed=discrete.fixed,
        bounds=am.Bounds(lower=lower),
    )
    assert am.solve(bounded).displacement == pytest.approx(
        am.solve(discrete).displacement, abs=1e-15
    )
    lower[discrete.contact.nodes[0], 0] = -1.0
    with pytest.raises(ValueError, match=r"several finite limits.*each face"):
        am.Bounds(lower=lower).at_nodes(discrete.fixed)


def test_a_result_is_saved_and_exported(tmp_path):
    result = am.solve(membrane(2, True))
    result.save(tmp_path / "run.npz")
    again = am.Result.load(tmp_path / "run.npz")
    assert (again.displacement == result.displacement).all() and str(again) == str(result)
    assert (again.contact.table() == result.contact.table()).all(axis=None)
    am.export.vtk(result, tmp_path / "run.vtu")
    points = meshio.read(tmp_path / "run.vtu").point_data
    assert (points["displacement"][:, 0] == result.displacement[:, 0]).all()
    assert set(result.pairs()) >= {"force_u [N]", "half_width_y [m]"}


def posed(**parts):
    matrix = sparse.diags_array(np.full(3, 2.0))
    given = {"matrix": matrix, "load": np.ones(3), "fixed": np.zeros(3, bool)}
    return am.DiscreteProblem(**given | parts)


def test_limits_may_cross_where_a_dof_is_fixed():
    """By rounding, say: x (1 - x) below 0 at the end of a string."""
    bounds = am.Bounds(lower=[1e-17, 0.0, 0.0], upper=[-1e-17, 0.1, 0.9])
    string = posed(fixed=np.array([True, False, False]), bounds=bounds)
    assert am.solve(string, am.SingleGrid()).displacement[:, 0] == pytest.approx([0.0, 0.1, 0.5])


def test_a_store_tells_no_limit_from_a_limit_of_zero(tmp_path):
    def solved(limit):
        limited = posed(bounds=am.Bounds(lower=-1.0, upper=[limit, 0.1, 0.9]))
        path = am.LoadPath(default=[1.0])
        return am.solve_path(limited, path, am.SingleGrid(), store=tmp_path)[0].displacement[:, 0]

    assert solved(np.inf) == pytest.approx([0.5, 0.1, 0.5])
    with pytest.raises(ValueError, match="belongs to another run: contact differs"):
        solved(0.0)
    assert solved(np.inf) == pytest.approx([0.5, 0.1, 0.5])


def held_at(value, **limits):
    square = am.Rectangle(width=1.0, height=1.0)
    return am.Hierarchy.uniform(am.ScalarProblem(domain=square, value=value, **limits), (2, 4))


def estimated(other):
    grids = held_at(0.0, load=1.0, upper=0.02)
    return am.Residual().indicate(
        grids.with_problem(replace(grids.problem, **other)), am.solve(grids)
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: posed(), "one of them"),
        (lambda: posed(bounds=am.Bounds(lower=1.0, upper=1.0)), "prescribe values"),
        (lambda: posed(bounds=am.Bounds(lower=[0, 0, 1], upper=[0.5] * 3)), "got 1 to 0.5"),
        (lambda: posed(bounds=am.Bounds(lower=np.inf)), r"bounds\.lower must be < inf"),
        (lambda: posed(bounds=am.Bounds(upper=-np.inf)), r"bounds\.upper must be > -inf"),
        (lambda: posed(bounds=am.Bounds(lower=[0.0, 1.0])), "3 entries, one a dof"),
        (lambda: posed(bounds=am.Bounds(upper=np.array([0, np.nan, 1]))), "must be finite"),
        (lambda: posed(bounds=am.Bounds(upper=1.0), law=am.Coulomb(0.1)), "no tangents"),
        (lambda: posed(bounds=3), "Bounds"),
        (lambda: am.plot.deformation(am.solve(membrane(2, False))), "scalar"),
        (lambda: am.plot.contact(am.solve(membrane(2, False))), "scalar"),
        (lambda: am.solve(membrane(2, False)).stress(), "scalar problem, which has no stresses"),
        (lambda: held_at(0.0, lower=0.1), "lower must leave.* 0.1 beyond it"),
        (lambda: held_at(0.0, upper=-0.1), "upper must leave.* 0.1 beyond it"),
        (lambda: am.Hierarchy.graded(am.ScalarProblem()), "from_meshes"),
        (lambda: am.adapt(am.cases.obstacle_problem(), indicator=am.Recovery()), "Residual"),
        (lambda: am.adapt(am.cases.obstacle_problem(), load_path=am.LoadPath()), "no load_path"),
        (lambda: held_at(0.0).with_problem(am.cases.greco_bar()), "another domain"),
        (lambda: estimated(other={"load": -2.0}), "other loads"),
        (lambda: estimated(other={"upper": 0.3}), "other limits"),
        (
            lambda: am.Recovery().indicate(membrane(2, False), am.solve(membrane(2, False))),
            "Scalar",
        ),
        (lambda: am.cases.obstacle_problem(depth=0.3), "depth must be below 0.25"),
    ],
)
def test_what_is_not_there_is_refused_with_a_remedy(call, words):
    with pytest.raises((ValueError, TypeError), match=words):
        call()
