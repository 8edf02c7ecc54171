"""No wrong answer in silence: bodies held by contact alone and their rigid motions, solvers that
are mistaken."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from smoother_problems import Idle

import adaptmg as am
from adaptmg.multigrid.rigid_motions import RigidMotions, null_combinations
from adaptmg.multigrid.split_matrix import split
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.factorisation import FACTORISED


def nearly_sliding(dim, law, held):
    """No support at all, pushed sideways by ``held`` of what friction can take: near 1 nearly all
    nodes slip."""
    pressure = 5e7
    push = held * (law.friction * pressure if isinstance(law, am.Coulomb) else law.limit)
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    return replace(
        case,
        supports=(),
        law=law,
        reference={},
        loads=(
            am.Pressure("top", pressure),
            am.Pressure("left", 1.5e8 + push),
            am.Pressure("right", 1.5e8),
        ),
    )


def test_a_body_held_by_contact_alone():
    problem = nearly_sliding(2, am.Coulomb(0.3), 0.3)
    nested = am.Hierarchy.uniform(problem, divisions=(2, 4, 8))
    independent = am.Hierarchy.graded(problem, sizes=(10e-3, 5e-3), contact_ratio=2)
    far = np.full((nested.finest.n_nodes, 2), 1e-3)
    for grids, start, *solvers in (
        (
            nested,
            None,
            am.FullMultigrid(),
            am.FullMultigrid(correction=am.Monotone()),
            am.SingleGrid(omega=1.8),
        ),
        (
            nested,
            far,
            am.Multigrid(),
            am.ActiveSet(),
            am.ActiveSet(condensed=False),
            am.ActiveSet(linear=am.AMG()),
        ),
        (independent, None, am.FullMultigrid()),
    ):
        exact = am.solve(grids, am.ActiveSet(rtol=1e-12)).displacement
        for solver in solvers:
            result = am.solve(grids, solver, start=start)
            assert np.abs(result.displacement - exact).max() < 1e-5 * np.abs(exact).max(), solver
            assert result.residual < 1e-7


@pytest.mark.parametrize(
    ("dim", "law", "held", "divisions"),
    [
        (2, am.Coulomb(0.3), 0.99, (4, 8, 16, 32)),
        (2, am.Tresca(2e7), 0.98, (4, 8, 16, 32)),
        (3, am.Coulomb(0.3), 0.95, (2, 4, 8)),
    ],
)
def test_a_body_that_nearly_slides_takes_few_cycles(dim, law, held, divisions):
    hierarchy = am.Hierarchy.uniform(nearly_sliding(dim, law, held), divisions=divisions)
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    for solver in (am.FullMultigrid(), am.Multigrid()):
        result = am.solve(hierarchy, solver, reference=exact)
        assert result.cycles <= 30 and not result.fallback
        assert result.history["true_error"][-1] < 1e-7


class Noise(Idle):
    """A linear correction that undoes what the smoothing gains."""

    def setup(self, matrices, prolongations):
        self.diagonal = matrices[-1].diagonal()
        self.rng = np.random.default_rng(0)
        return self

    def solve(self, rhs):
        size = np.abs(rhs / self.diagonal).max()
        return 10 * size * self.rng.standard_normal(len(rhs))


#: cycles that only smooth
SMOOTHING = am.Multigrid(correction=am.Truncated(correct=Idle(), recombine=0))


@pytest.fixture
def failing():
    """Grids, and coarse spaces alone."""
    grids = am.Hierarchy.uniform(nearly_sliding(2, am.Tresca(2e7), 0.98), (4, 8, 16))
    return grids, am.Hierarchy.algebraic(grids.finest.discrete, max_coarse=60)


def test_the_active_set_method_takes_over(failing):
    exact = am.solve(failing[0], am.ActiveSet(rtol=1e-12)).displacement
    for grids in failing:
        result = am.solve(grids, SMOOTHING)
        assert "ActiveSet from cycle" in result.fallback
        assert np.isnan(result.rate)  # of Newton steps it would be that of no cycle
        # one count of cycles and of work for both
        assert result.history["cycle"][-1] == result.cycles
        assert all((np.diff(result.history[name]) >= 0).all() for name in ("cycle", "work_units"))
        assert np.abs(result.displacement - exact).max() < 1e-8 * np.abs(exact).max()
        early = am.solve(grids, replace(SMOOTHING, max_cycles=2), throw=False)
        assert early.status is am.Status.LIMIT and not early.fallback


def test_residuals_that_do_not_fall_are_handed_over(failing):
    exact = am.solve(failing[0], am.ActiveSet(rtol=1e-12)).displacement
    noisy = am.Multigrid(correction=am.Truncated(correct=Noise(), recombine=0))
    result = am.solve(failing[0], noisy)
    assert "ActiveSet from cycle" in result.fallback
    assert np.abs(result.displacement - exact).max() < 1e-8 * np.abs(exact).max()


@pytest.mark.parametrize("reason", ["too large", "gives up"])
def test_the_monotone_correction_takes_over_from_what_cannot(reason, failing, monkeypatch):
    if reason == "too large":
        monkeypatch.setitem(FACTORISED, 2, 0)
    else:

        def singular(self, hierarchy, run, start):
            raise np.linalg.LinAlgError("singular")

        monkeypatch.setattr(am.ActiveSet, "run", singular)
    result = am.solve(failing[0], SMOOTHING, throw=False)
    assert "Monotone from cycle" in result.fallback
    # slow, but on its way, and not in silence
    assert result.residual < 1e-2 and result.status.ok == (result.residual <= 1e-7)
    if reason == "gives up":
        # an error of one method is not an error of the run, and coarse spaces know no other one
        nothing = am.solve(failing[1], SMOOTHING, throw=False)
        assert not nothing.status.ok and not nothing.fallback


def test_nothing_takes_over_where_arithmetic_ends():
    hierarchy = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16, 32))
    with pytest.warns(UserWarning, match="rtol=1e-17 is below what double precision reaches"):
        result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-17))
    assert not result.fallback and result.residual < 1e-11 and result.rtol < 1e-11


def test_a_large_coarsest_grid_is_factorised_sparse():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (28, 56))
    assert grids[0].discrete.n_dofs > 1500
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    result = am.solve(grids, am.FullMultigrid(), reference=exact)
    assert not result.fallback and result.cycles <= 15 and result.history["true_error"][-1] < 3e-8


def test_cycles_that_rest_while_nodes_open_go_on():
    """A heated block that nothing but friction holds opens from its edges inwards."""
    block = am.Box(width=0.98306, depth=0.98306, height=1.12838)
    problem = am.ContactProblem(
        domain=block,
        material=am.Solid(young=2e11, poisson=0.3),
        law=am.Coulomb(0.1),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))),
        loads=(am.Pressure("top", 2.79609e5), am.InitialStrain("body", (5.757562e-6,) * 3)),
    )
    grids = am.Hierarchy.uniform(problem, (2, 4))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12)).displacement
    result = am.solve(grids, am.Multigrid(rtol=1e-6))
    assert not result.fallback
    assert np.abs(result.displacement - exact).max() <= 1e-5 * np.abs(exact).max()


@pytest.mark.parametrize(("pull", "ratio", "finest"), [(-2e7, 25, 12), (5e7, 100, 16)])
def test_a_stiff_slave_on_a_soft_master_is_handed_over(pull, ratio, finest):
    """Little friction: left alone, cycles from zero take 39, in the last case more than 100."""
    parts = {
        "upper": am.Rectangle(width=40e-3, height=40e-3),
        "lower": am.Rectangle(width=60e-3, height=30e-3, origin=(-8e-3, -30e-3)),
    }
    young = {"upper": 1e11, "lower": 1e11 / ratio}
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        contact=am.ContactPair("upper.bottom", "lower.top"),
        law=am.Coulomb(0.05),
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        loads=(am.Pressure("upper.top", 5e7), am.Pressure("upper.left", pull)),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)),
    )
    grids = am.Hierarchy.uniform(
        problem, [{"upper": k, "lower": (3 * k // 2 + 1, 3 * k // 4)} for k in (4, 8, finest)]
    )
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    for solver in (am.FullMultigrid(), am.Multigrid()):
        result = am.solve(grids, solver)
        assert result.cycles < 45
        assert (
            np.abs(result.displacement - exact.displacement).max()
            <= 1e-6 * np.abs(exact.displacement).max()
        )


RADIUS, CLEARANCE, HOLE, OUTER = 10e-3, 0.02e-3, 5e-3, 20e-3
LOADS = {
    "shaft": (am.Traction("pin.hole", (0.0, lambda x: np.minimum(0.0, x[:, 1]) / HOLE * 1e7)),),
    "torque": (
        am.BodyForce((0.0, -1e10), body="pin"),
        am.Traction("pin.hole", (lambda x: -2e6 * x[:, 1] / HOLE, lambda x: 2e6 * x[:, 0] / HOLE)),
    ),
}


def ring(outer, outside, inner, inside):
    return am.Cut(am.Circle((0.0, 0.0), outer, outside), am.Circle((0.0, 0.0), inner, inside))


@pytest.mark.parametrize(("friction", "load"), [(0.3, "torque"), (0.6, "shaft")])
def test_methods_solve_a_pin_that_contact_alone_holds(friction, load):
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=2.1e11, poisson=0.3),
        law=am.Coulomb(friction),
        loads=LOADS[load],
        domain=am.Assembly(
            parts={
                "pin": ring(RADIUS, "surface", HOLE, "hole"),
                "bush": ring(OUTER, "outer", RADIUS + CLEARANCE, "bore"),
            }
        ),
        contact=am.ContactPair("pin.surface", "bush.bore"),
        supports=am.Support("bush.outer", x=0.0, y=0.0),
    )
    grids = am.Hierarchy.graded(problem, (4e-3, 2e-3), contact_ratio=4)
    discrete = grids.finest.discrete
    for solver, rtol in ((None, 1e-8), (am.ActiveSet(), 1e-10)):
        result = am.solve(grids, solver)
        assert result.certificate(discrete, bound=True).energy_error <= 3 * rtol
        assert (result.contact.state != am.OPEN).sum() > 2
        # friction and pressure of the bush carry what acts on the pin
        force = discrete.coupling.physical_forces(discrete.load).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(
            result.resultant("contact").force, -force, atol=1e-6 * np.linalg.norm(force)
        )


ALL_ROUND = (am.Pressure("top", 5e7), am.Pressure("left", 1.6e8), am.Pressure("right", 1.5e8))


def discrete(dim, law=None, **changes):
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    law = am.Tresca(4e7) if law is None else law
    problem = replace(
        case, **({"supports": (), "law": law, "loads": ALL_ROUND, "reference": {}} | changes)
    )
    return am.Hierarchy.uniform(problem, divisions=(6 if dim == 2 else 3,)).finest.discrete


class Body:
    """A body near its obstacle with random displacements, motions settled once."""

    def __init__(self, problem, seed=0, opening=0.0, size=1e-6):
        rng = np.random.default_rng(seed)
        self.problem, self.contact = (
            problem,
            TruncatedContact.of(problem, split(problem.matrix, problem.fixed)),
        )
        self.unknowns = size * rng.standard_normal(problem.n_dofs)
        self.unknowns[problem.dim * problem.contact.nodes + problem.dim - 1] = opening * rng.random(
            len(problem.contact.nodes)
        )
        self.unknowns[problem.fixed] = 0.0
        self.contact.start(self.unknowns)
        self.before = self.unknowns.copy()
        self.motions = RigidMotions.of(problem, self.contact, problem.load)

    def settle(self):
        residual = self.problem.load - self.problem.matrix @ self.unknowns
        return self.motions.settle(self.contact, self.unknowns, residual)

    def energy(self, unknowns):
        """Tresca energy without u'Au; infinite where a node penetrates."""
        problem, dim = self.problem, self.problem.dim
        local = np.einsum(
            "nij,nj->ni",
            self.contact.frames.reshape(-1, dim, dim),
            unknowns.reshape(-1, dim)[problem.contact.nodes],
        )
        if (local[:, 0] > self.contact.gap + 1e-18).any():
            return np.inf
        return float(
            self.contact.limit @ np.linalg.norm(local[:, 1:], axis=1) - problem.load @ unknowns
        )


@pytest.mark.parametrize("opening", [0.0, 1e-6])
@pytest.mark.parametrize("dim", [2, 3])
def test_no_rigid_motion_lowers_the_energy_further(dim, opening, seed=1):
    body = Body(discrete(dim), seed, opening)
    motion = body.settle()
    least, moved = body.energy(body.unknowns), body.unknowns - body.before
    assert np.allclose(motion, moved, atol=1e-9 * np.abs(moved).max()) and moved.any()
    assert least <= body.energy(body.before)
    modes, rng = body.problem.near_nullspace, np.random.default_rng(seed)
    # the step itself is rigid: A m = 0, so that no residual changes
    coefficients, *_ = np.linalg.lstsq(modes, moved, rcond=None)
    assert np.abs(modes @ coefficients - moved).max() < 1e-9 * np.abs(moved).max()
    span = np.abs(moved).max() + 1e-6
    others = [least]
    for _ in range(300):
        mode = modes @ (rng.standard_normal(modes.shape[1]) / np.abs(modes).max(axis=0))
        others += [
            body.energy(body.unknowns + 10.0 ** rng.uniform(-6, 1) * span * sign * mode)
            for sign in (1, -1)
        ]
    # in 3D the gradient is small only
    work = np.abs(modes.T @ body.problem.load / np.abs(modes).max(axis=0)).max()
    assert least <= min(others) + (1e-12 if dim == 2 else 2e-2) * work * 10 * span


@pytest.mark.parametrize("dim", [2, 3])
def test_friction_that_cannot_hold_yet_moves_nothing_far(dim):
    body = Body(discrete(dim, am.Coulomb(1e-3)))
    assert body.settle() is not None
    # in 2D a node holds the body all the same
    assert dim == 3 or (body.contact.values[1::2] == 0.0).any()
    assert np.abs(body.unknowns).max() < 1e2 * np.abs(body.before).max()


def test_a_body_without_friction_slides_to_the_wall():
    distance = 1e-5
    floor, wall = (
        am.Contact(boundary, am.Plane(point, normal))
        for boundary, point, normal in (
            ("bottom", (0.0, 0.0), (0.0, 1.0)),
            ("right", (40e-3 + distance, 0.0), (-1.0, 0.0)),
        )
    )
    problem = discrete(2, am.Frictionless(), contact=(floor, wall), loads=ALL_ROUND[:2])
    motion = problem.physical(Body(problem, size=0.0).settle())
    np.testing.assert_allclose(motion, np.tile([distance, 0.0], (len(motion), 1)), atol=1e-15)


def test_motions_that_strain_the_body_are_given_up():
    problem = discrete(2)
    body = Body(
        replace(
            problem,
            near_nullspace=problem.near_nullspace * np.linspace(1, 2, problem.n_dofs)[:, None],
        )
    )
    assert body.settle() is None and (body.unknowns == body.before).all()


def test_supports_leave_none():
    problem = discrete(2, supports=(am.Support("top", x=0.0, y=0.0),), loads=ALL_ROUND[1:])
    obstacle = TruncatedContact.of(problem, split(problem.matrix, problem.fixed))
    assert RigidMotions.of(problem, obstacle, problem.load) is None
    assert (
        RigidMotions.of(
            replace(problem, near_nullspace=None, coordinates=None), obstacle, problem.load
        )
        is None
    )


@pytest.mark.parametrize("collinear", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_as_many_motions_are_free_as_no_fixed_component_sees(dim, collinear):
    problem = discrete(dim)
    rng = np.random.default_rng(dim)
    inner = np.setdiff1d(np.arange(problem.n_nodes), problem.contact.nodes)
    across = problem.coordinates[inner][:, 1:]
    line = inner[(across == across[0]).all(axis=1)]
    free = []
    for count in (1, 2, 2, 3, 3, 4):
        fixed = np.zeros((problem.n_nodes, dim), dtype=bool)
        chosen = rng.choice(line if collinear else inner, size=min(count, len(line)), replace=False)
        fixed[chosen] = rng.random((len(chosen), dim)) < 0.8
        held = replace(problem, fixed=fixed.reshape(-1), near_nullspace=None)
        contact = TruncatedContact.of(held, split(held.matrix, held.fixed))
        motions = RigidMotions.of(held, contact, held.load)
        modes = problem.near_nullspace
        rank = np.linalg.matrix_rank(modes[fixed.reshape(-1)], tol=1e-9)
        assert (motions.at_contact.shape[2] if motions else 0) == modes.shape[1] - rank
        free.append(modes.shape[1] - rank)
    assert max(free) > 0 and (min(free) == 0 or collinear)


def test_null_combinations_do_not_depend_on_units():
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((5, 4)) @ np.diag([1e-6, 1.0, 1e6, 1e3])
    assert null_combinations(rows).shape == (4, 0)
    found = null_combinations(rows[:3])
    assert (
        found.shape == (4, 1)
        and np.abs(rows[:3] @ found).max() < 1e-12 * np.abs(rows[:3] * found.T).max()
    )
    assert null_combinations(np.zeros((0, 4))).shape == (4, 4)


@pytest.mark.parametrize("divisions", [(4, 8, 16), (16, 32)])
def test_coarse_functions_that_no_fine_node_tells_apart_change_nothing(divisions):
    """The last function of the coarsest level is there twice, each by half."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions)
    first, *others = (level.prolongation for level in grids.levels[1:])
    halves = 0.5 * first[:, [-1, -1]]
    twice = sparse.csr_array(sparse.hstack([first[:, :-1], halves]))
    plain, doubled = (
        am.solve(am.Hierarchy.from_prolongations(grids.finest.discrete, [one, *others]))
        for one in (first, twice)
    )
    assert doubled.cycles == plain.cycles and not doubled.fallback
    np.testing.assert_allclose(
        doubled.displacement, plain.displacement, atol=1e-7 * np.abs(plain.displacement).max()
    )
