"""The certificate: each line catches its fault, and the status needs it (what it may import:
pyproject.toml)."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from bodies import bar_hierarchy, bar_on_block, rotation
from scipy import sparse
from scipy.sparse.linalg import spsolve
from study_scripts import load

import adaptmg as am
from adaptmg.solver.aggregates import Aggregates, CoarseCorrection
from adaptmg.solver.certificate import certify
from adaptmg.solver.record import Outcome

EXACT = am.ActiveSet(rtol=1e-12)
ROUNDING = 1e-13  # relative energy errors below say nothing
LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(2e7), "coulomb": am.Coulomb(1.0)}


@cache
def grids(law="coulomb", dim=2, divisions=None):
    """The bar (block) pressed at one end, so that nodes are open, slip and stick."""
    case = am.cases.greco_bar if dim == 2 else am.cases.greco_block
    return am.Hierarchy.uniform(
        case(law=LAWS[law]), divisions or ((4, 8, 16) if dim == 2 else (2, 4))
    )


@cache
def exact(law="coulomb", dim=2):
    return am.solve(grids(law, dim), EXACT)


@dataclass(frozen=True)
class Returns:
    displacement: np.ndarray
    rtol: float = 1e-6

    def run(self, hierarchy, run, start):
        return Outcome(
            self.displacement, am.Status.CONVERGED, cycles=1, rtol=self.rtol, error_estimate=0.0
        )


def energy(discrete, displacement):
    w = discrete.relative(displacement).ravel()
    return np.sqrt(w @ (discrete.matrix @ w))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_a_solution_violates_nothing(law, dim):
    certificate = exact(law, dim).certificate()
    assert not certificate.contradictions(1e-11)
    assert (
        max(line.relative for line in certificate.lines) <= 1e-11
        and certificate.energy_error <= 1e-11
    )


def test_the_scales_are_forces_and_the_largest_displacement():
    result, discrete, certificate = exact(), grids().finest.discrete, exact().certificate()
    supports, load, contact = (
        result.reaction.copy(),
        *map(np.linalg.norm, (discrete.load, result.contact.force)),
    )
    supports[result.contact.node] -= result.contact.force
    held = np.linalg.norm(supports[discrete.fixed.reshape(supports.shape)])
    assert certificate.force == pytest.approx(max(load, contact, held))
    assert certificate.displacement == np.abs(result.displacement).max()
    assert certificate.energy_norm == pytest.approx(energy(discrete, result.displacement))


def bare():
    return grids().finest.discrete


def posed(**contact):
    return replace(bare(), contact=replace(bare().contact, **contact))


def solution_of(problem):
    return am.solve(problem, EXACT).displacement


def perturbed():
    noise = np.random.default_rng(1).normal(size=exact().displacement.shape)
    noise[bare().fixed.reshape(noise.shape)] = 0.0
    return exact().displacement + 1e-4 * np.abs(exact().displacement).max() * noise


def with_a_penetrating_node():
    u, contact = exact().displacement.copy(), exact().contact
    i = int(np.argmax(contact.force_n))
    u[contact.node[i]] += 1e-7 * contact.normal[i]
    return u


def glued():
    u = np.zeros_like(exact().displacement)
    free = ~bare().fixed.reshape(u.shape)
    free[exact().contact.node] = False
    u[free] = spsolve(
        bare().matrix.tocsc()[free.ravel()][:, free.ravel()], bare().load[free.ravel()]
    )
    return u


#: a displacement that a solver returns, the lines that must name its fault, and the largest entry of the first line
FAULTS = {
    "perturbed": (perturbed, ("equilibrium", "penetration", "energy error"), None),
    "flipped": (lambda: -exact().displacement, ("equilibrium", "energy error"), None),
    "moved supports": (
        lambda: solution_of(replace(bare(), fixed_values=1e-5 * bare().fixed)),
        ("prescribed values", "energy error"),
        1e-5,
    ),
    "a node too deep": (with_a_penetrating_node, ("penetration", "equilibrium"), 1e-7),
    "all too deep": (
        lambda: solution_of(posed(gaps=bare().contact.gaps + 1e-6)),
        ("penetration",),
        1e-6,
    ),
    "hovering": (
        lambda: solution_of(posed(gaps=bare().contact.gaps - 1e-6, allow_interference=True)),
        ("open, touching", "complementarity"),
        None,
    ),
    "glued": (glued, ("tension", "friction bound"), None),
    "more friction": (
        lambda: solution_of(replace(bare(), law=am.Coulomb(2.0))),
        ("friction bound",),
        None,
    ),
    "less friction": (
        lambda: solution_of(replace(bare(), law=am.Coulomb(0.5))),
        ("slip direction",),
        None,
    ),
    "no friction": (
        lambda: solution_of(replace(bare(), law=am.Frictionless())),
        ("slip direction",),
        None,
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_displacement_is_named_and_does_not_converge(fault):
    make, names, largest = FAULTS[fault]
    result = am.solve(grids(), Returns(make()), throw=False)
    assert not result.status.ok
    found = result.certificate().contradictions(1e-6)
    assert set(names) <= set(found), found
    assert largest is None or result.certificate()[names[0]].largest == pytest.approx(
        largest, rel=1e-6
    )


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_displacement_off_a_plane_support_is_named_at_any_angle(angle):
    turn = rotation(angle)
    square = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e7, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane((0, 0), turn[:, 1])),
        loads=[am.Pressure("top", 1e4)],
        supports=[am.Support("left", normal=-1e-3)],
    )
    mesh = replace(square, points=square.points @ turn.T)
    supported = am.Hierarchy.from_meshes(problem, [mesh])
    moved = am.solve(supported, EXACT).displacement.copy()
    moved[mesh.boundary_nodes("left")[2]] += 1e-6 * turn[:, 0]
    result = am.solve(supported, Returns(moved), throw=False)
    assert not result.status.ok
    assert "prescribed values" in result.certificate().contradictions(1e-6)
    deviation = result.certificate()["prescribed values"].largest
    assert deviation == pytest.approx(1e-6, rel=1e-6)


def test_not_finite_or_run_away():
    for value in (np.nan, np.inf, 1e200):
        u = exact().displacement.copy()
        u[5] = value
        assert "equilibrium" in certify(bare(), u, exact().contact).contradictions(1e-2)


def contradictions(**changes):
    contact = replace(exact().contact, **changes)
    return certify(bare(), exact().displacement, contact).contradictions(1e-8)


@pytest.mark.parametrize(
    ("factor_n", "factor_t", "names"),
    [
        (1, -1, {"equilibrium", "slip direction", "slip along the force"}),
        (-1, 1, {"equilibrium", "tension"}),
        (1, 2, {"equilibrium", "friction bound"}),
        (0, 0, {"equilibrium", "balance"}),
    ],
)
def test_wrong_forces_of_a_right_displacement_are_named(factor_n, factor_t, names):
    contact = exact().contact
    assert names <= set(
        contradictions(force_n=factor_n * contact.force_n, force_t=factor_t * contact.force_t)
    )


@pytest.mark.parametrize(
    ("was", "claimed", "name"),
    [
        (am.SLIP, am.STICK, "slip, sticking"),
        (am.SLIP, am.OPEN, "open, touching"),
        (am.STICK, am.OPEN, "open, touching"),
        (am.OPEN, am.SLIP, "touching, open"),
    ],
)
def test_wrong_states_of_a_right_displacement_are_named(was, claimed, name):
    contact = exact().contact
    free = ~bare().fixed.reshape(-1, 2)[contact.node].any(axis=1)
    assert (contact.state[free] == was).any()
    assert contradictions(state=np.where(contact.state == was, claimed, contact.state)) == (name,)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "solver",
    [
        am.FullMultigrid(rtol=1e-3),
        am.FullMultigrid(rtol=1e-6),
        am.SingleGrid(rtol=1e-3, omega=1.8),
        am.Multigrid(correction=am.Monotone(), rtol=1e-2),
    ],
    ids=repr,
)
def test_the_energy_error_is_estimated(solver, law, dim):
    discrete, u = grids(law, dim).finest.discrete, exact(law, dim).displacement
    result = am.solve(grids(law, dim), solver, throw=False)
    # where the solver ends far below its tolerance, both are rounding
    estimate, bound = (
        max(found.energy_error, ROUNDING)
        for found in (result.certificate(), result.certificate(discrete, bound=True))
    )
    true = max(energy(discrete, result.displacement - u) / energy(discrete, u), ROUNDING)
    assert 0.5 * true <= estimate <= 1.5 * true and 0.8 * true <= bound <= 1.2 * true


@pytest.mark.parametrize("seed", [60055, 60083, 60187])
def test_the_estimate_misses_no_errors_that_converge_slowly(seed):
    """Bodies of very different sizes and stiffness: what steps had removed alone was .81 to .87 of
    the error."""
    hierarchy = load("random_problems").random_problem(seed)
    for cycles in (3, 10):
        result = am.solve(
            hierarchy,
            am.FullMultigrid(rtol=1e-12, max_cycles=cycles, correction=am.Monotone()),
            throw=False,
        )
        estimate, bound = (
            result.certificate(hierarchy.finest.discrete, bound=exactly).energy_error
            for exactly in (False, True)
        )
        assert 0.93 * bound <= estimate <= 1.2 * bound


def scaled_ring(length, force):
    """A ring that contact alone holds, above a plane, its lengths and pressures scaled."""
    return am.Hierarchy.graded(
        am.ContactProblem(
            name="ring",
            domain=am.Rectangle(width=length, height=length, origin=(0.3 * length, 0.0)),
            material=am.Axisymmetric(young=2e11, poisson=0.3),
            law=am.Frictionless(),
            contact=am.Contact(
                "bottom", am.Plane(point=(0.0, -1e-4 * length * force), normal=(0.0, 1.0))
            ),
            loads=(am.Pressure("top", 1e6 * force), am.Pressure("right", 2e6 * force)),
        ),
        [0.3 * length, 0.16 * length, 0.08 * length],
        3.0,
    )


@pytest.mark.parametrize(
    "make",
    [
        lambda: scaled_ring(*10 ** np.random.default_rng().uniform(-1, 1, 2)),
        *(lambda seed=seed: load("random_problems").random_floating(seed) for seed in (4, 25)),
    ],
    ids=["ring", "blocks", "smooth blocks"],
)
def test_bodies_that_contact_alone_holds(make):
    hierarchy = make()
    discrete = hierarchy.finest.discrete
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12)).displacement
    for solver in (
        am.SingleGrid(rtol=0.05, omega=1.8),
        am.SingleGrid(rtol=5e-3, omega=1.8),
        am.Multigrid(correction=am.Monotone(), rtol=1e-2),
    ):
        u = am.solve(hierarchy, solver).displacement
        assert energy(discrete, u - exact) <= 1.5 * solver.rtol * energy(discrete, exact)


def test_a_loaded_motion_that_is_free_is_an_infinite_error():
    hierarchy = scaled_ring(*10 ** np.random.default_rng().uniform(-1, 1, 2))
    discrete = hierarchy.finest.discrete
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12)).displacement
    hovers = am.solve(hierarchy, am.SingleGrid(rtol=1e-9, omega=1.7, max_sweeps=100), throw=False)
    assert (hovers.contact.state == am.OPEN).all()
    assert hovers.certificate(discrete, bound=True).energy_error == np.inf
    unmoved = am.solve(hierarchy, Returns(np.zeros_like(exact)), throw=False)
    assert unmoved.certificate(discrete, bound=True).energy_error == np.inf
    # where the status may change the error is finite
    true = energy(discrete, hovers.displacement - exact) / energy(discrete, hovers.displacement)
    assert 0.67 * true <= hovers.checked.energy_error <= 1.5 * true


def test_a_status_that_hides_the_error_may_change():
    """Newton steps on a slender body: with the status held a tenth of the error is seen."""
    hierarchy = load("slender_bodies").random_slender(6)
    discrete = hierarchy.finest.discrete
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-9, max_steps=200)).displacement
    result = am.solve(hierarchy, am.ActiveSet(rtol=1e-9, max_steps=5, start="held"), throw=False)
    true = energy(discrete, result.displacement - exact) / energy(discrete, result.displacement)
    assert result.certificate(discrete, bound=True).energy_error < 0.2 * true
    assert 0.67 * true <= result.checked.energy_error <= 1.5 * true


def test_nothing_is_missing_where_all_dofs_are_fixed():
    contact = am.ContactNodes(nodes=[], normals=np.empty((0, 2)), gaps=[])
    problem = am.DiscreteProblem(
        matrix=sparse.eye_array(4),
        load=np.ones(4),
        fixed=np.ones(4, dtype=bool),
        law=am.Frictionless(),
        contact=contact,
    )
    assert am.solve(problem, am.SingleGrid()).checked.energy_error == 0.0


def test_few_steps_are_not_too_small():
    """Where the tolerance is far above the error, the estimate is that error or more."""
    hierarchy = grids(divisions=(4, 8, 16, 32, 64))
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-6), throw=False)
    true = result.certificate(hierarchy.finest.discrete, bound=True).energy_error
    discrete = hierarchy.finest.discrete
    for rtol in (0.0, true, 3 * true, 100 * true):
        estimate = certify(discrete, result.displacement, result.contact, rtol=rtol).energy_error
        assert 0.75 * true <= estimate <= 1.6 * true


def test_a_result_shares_no_array_with_the_solver():
    given = exact().displacement.copy()
    result = am.solve(grids(), Returns(given))
    given[:] = 0.0
    assert (result.displacement == exact().displacement).all()


def test_no_error_estimate_is_better_than_the_certificate():
    for factor, rtol, status in (
        (0.0, 0.5, "STALLED"),
        (0.9, 0.5, "CONVERGED"),
        (0.9, 1e-2, "STALLED"),
        (1.0, 1e-8, "CONVERGED"),
        (1.0001, 1e-8, "STALLED"),
        # forces are missing that are as large as the largest ones
        (1.9, 1e-8, "STALLED"),
        (2.1, 1e-8, "DIVERGED"),
    ):
        result = am.solve(grids(), Returns(factor * exact().displacement, rtol), throw=False)
        assert (
            result.error_estimate >= result.checked.energy_error
            and result.status is am.Status[status]
        )
        assert result.checked.energy_error > 0.05 or factor >= 1
    with pytest.raises(am.NotConverged):
        am.solve(grids(), Returns(1.0001 * exact().displacement, 1e-8))
    # unconverged, where the rate of the cycles promises much
    for cycles in (2, 5):
        result = am.solve(grids(), am.Multigrid(max_cycles=cycles), throw=False)
        assert result.error_estimate >= result.checked.energy_error


def test_it_is_printed_saved_and_computed_again(tmp_path):
    result = exact()
    assert f"worst {result.certificate().worst.name}" in repr(result)
    text = str(result.certificate())
    assert all(line.name in text for line in result.certificate().lines) and "energy error" in text
    result.save(tmp_path / "run.npz")
    loaded = am.Result.load(tmp_path / "run.npz")
    assert loaded.certificate() == result.certificate() and isinstance(
        loaded.certificate(), am.Certificate
    )
    again = loaded.certificate(grids().finest.discrete, bound=True)
    # what is posed is not computed again
    assert again.exact_energy and again.lines == result.certificate().lines[: len(again.lines)]
    with pytest.raises(ValueError, match=r"^problem: this result keeps no matrix"):
        loaded.certificate(bound=True)
    with pytest.raises(TypeError, match="problem must be"):
        loaded.certificate(grids())
    with pytest.raises(KeyError, match="no line 'gap'"):
        again["gap"]


def test_faults_of_friction_at_supports_are_caught():
    """Nodes that a support drives along the contact: friction acts there as everywhere."""
    problem = replace(
        bar_on_block(am.Coulomb(0.4)),
        loads=(am.Pressure("upper.top", 1e7),),
        supports=(
            am.Support("upper.left", x=0.0),
            am.Support("upper.right", x=0.0),
            am.Support("lower.right", x=1e-3),
            am.Support("lower.bottom", x=1e-3, y=0.0),
        ),
    )
    hierarchy = bar_hierarchy(problem, 2)
    # 1 mm of slip against micrometres of strain: fewer digits
    discrete, result = hierarchy.finest.discrete, am.solve(hierarchy, am.ActiveSet(rtol=1e-10))
    contact = result.contact
    assert not result.certificate().contradictions(1e-9)
    held = discrete.fixed.reshape(result.displacement.shape)[contact.node].any(axis=1)
    assert held.sum() == 1 and (contact.force_n[held] > 0).all()

    def found(**changes):
        return certify(discrete, result.displacement, replace(contact, **changes)).contradictions(
            1e-6
        )

    assert "slip direction" in found(force_t=contact.force_t * ~held[:, None])
    assert "friction bound" in found(force_t=contact.force_t * (1 + held[:, None]))
    assert found(state=np.where(held, am.STICK, contact.state)) == ("slip, sticking",)
    # the master must carry the friction of held nodes, too
    share = np.zeros_like(contact.master_force)
    share[np.argmax(np.abs(contact.master_force[:, 0])), 0] = (
        0.1 * np.abs(contact.master_force).max()
    )
    assert "equilibrium" in found(master_force=contact.master_force + share)
    assert {"equilibrium", "balance"} <= set(found(master_force=-contact.master_force))
    assert {line.unit for line in result.certificate().lines} == {"N", "m", "N m", ""}


@pytest.mark.parametrize(
    "grids",
    [
        lambda: am.Hierarchy.graded(am.cases.obstacle_problem(), sizes=(0.1,)),
        lambda: am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(17,)),
        lambda: am.Hierarchy.uniform(am.cases.greco_block(), divisions=(6,)),
    ],
    ids=["scalar", "2D", "3D"],
)
def test_the_coarse_correction_is_galerkins(grids):
    discrete = grids().finest.discrete
    n, dim = discrete.n_nodes, discrete.dim
    every, kept = np.arange(n), np.tile(np.eye(dim), (n, 1, 1))
    kept[:3, 0] = 0.0
    aggregates = Aggregates(discrete)
    dense, residual = discrete.matrix.toarray(), np.random.default_rng(0).standard_normal(n * dim)
    blocks = np.stack([np.diag(row) for row in discrete.matrix.diagonal().reshape(n, dim)])
    coarse = np.zeros(n * dim)
    correction = CoarseCorrection(discrete.rows, aggregates, every, kept, every, blocks)
    correction.add(residual, coarse)
    basis = aggregates.span(kept).toarray()
    dense += np.diag(np.diag(dense))
    exact = basis @ np.linalg.solve(basis.T @ dense @ basis, basis.T @ residual)
    np.testing.assert_allclose(coarse, exact, atol=1e-8 * abs(exact).max())


def test_steps_with_friction_estimate_the_factorised_error_closely():
    """Directions that are not orthonormal in the energy make it 1.1 times too large here."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(1.0)), (4, 8, 16))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-2))
    factorised = result.certificate(grids.finest.discrete, bound=True).energy_error
    assert 1.0 <= result.certificate().energy_error / factorised < 1.06
