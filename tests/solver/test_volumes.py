"""Nearly incompressible bodies with smoothed elements: groups of nodes, their pressures, and every
method with them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bisected_meshes import shaken
from norms import far
from paths import resumed
from refused import refused
from scipy.optimize import nnls

import adaptmg as am
from adaptmg.cases.closed_forms import quarter_cylinder
from adaptmg.discrete.volumes import GROUP, Volumes, volume_groups
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.solver.certificate import certify
from adaptmg.solver.record import Outcome

KINDS = {"plane strain": am.PlaneStrain, "axisymmetric": am.Axisymmetric, "solid": am.Solid}
EACH_KIND = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


@cache
def glued(dim: int, seed: int = 0) -> am.MeshArrays:
    """Three bodies that share the nodes of the planes between them, with shaken and renumbered
    nodes."""
    mesh = am.mesh.structured(
        am.Rectangle(width=3.0, height=1.0)
        if dim == 2
        else am.Box(width=3.0, depth=1.0, height=1.0),
        (9, 4) if dim == 2 else (6, 3, 3),
    )
    between, x = np.isclose(mesh.points[:, :1] % 1, 0), mesh.points[mesh.elements, 0].mean(axis=1)
    order = (
        np.random.default_rng(seed).permutation(mesh.n_nodes) if seed else np.arange(mesh.n_nodes)
    )
    points = np.where(between, mesh.points, shaken(mesh, 0.05, 1).points)
    return replace(
        mesh,
        points=points[np.argsort(order)],
        elements=order[mesh.elements],
        facets=order[mesh.facets],
        element_body=np.floor(x).astype(int),
        bodies=("soft", "steel", "rubber"),
    )


def three(kind) -> dict:
    return {
        "soft": kind(young=2e6, poisson=0.45),
        "steel": kind(young=2e11, poisson=0.3),
        "rubber": kind(young=1e6, poisson=0.5),
    }


@EACH_KIND
def test_groups_have_the_mean_divergence_of_their_own_body(kind):
    mesh, around = glued(3 if kind is am.Solid else 2), kind is am.Axisymmetric
    groups, dim = volume_groups(mesh, three(kind)), mesh.dim
    rows, measures = np.zeros(groups.rows.shape), mesh.volumes.copy()
    for e, corners in enumerate(mesh.elements):
        slopes = np.linalg.inv(np.column_stack([np.ones(dim + 1), mesh.points[corners]]))[1:].T
        if around:
            radius = mesh.points[corners, 0].mean()
            measures[e] *= 2 * np.pi * radius
            slopes[:, 0] += 1 / (3 * radius)
        for group in groups.corners[e]:
            if group >= 0:
                at = (dim * corners[:, None] + np.arange(dim)).reshape(-1)
                rows[group, at] += measures[e] / (dim + 1) * slopes.reshape(-1)
    np.testing.assert_allclose(groups.rows.toarray(), rows, rtol=0, atol=1e-13 * np.abs(rows).max())
    of = {
        name: set(groups.corners[mesh.element_body == k].reshape(-1))
        for k, name in enumerate(mesh.bodies)
    }
    assert of["steel"] == {-1} and not of["soft"] & of["rubber"]
    assert of["soft"] | of["rubber"] == set(range(len(groups)))
    members = np.diff(groups.means.indptr)
    assert members.min() >= GROUP[dim] and members.max() <= 2 * GROUP[dim]
    np.testing.assert_allclose(groups.means.sum(axis=1), 1.0)
    soft = np.isin(mesh.element_body, (0, 2))
    assert groups.areas.sum() == pytest.approx(measures[soft].sum())
    # 1 / (lam - 4 mu)
    assert sorted(set(groups.compliance)) == pytest.approx([0.0, 1 / (5 * 2e6 / 2.9)])
    constant = np.full(len(groups), 3.0)
    np.testing.assert_allclose(groups.of_elements(constant), 3.0 * soft)


@pytest.mark.parametrize("poisson", [0.3, 0.4])
def test_bodies_up_to_a_ratio_of_two_fifths_have_no_groups(poisson):
    assert len(volume_groups(glued(2), am.PlaneStrain(young=1e6, poisson=poisson))) == 0


@pytest.mark.parametrize("divisions", [(1, 1), (2, 1)])
def test_a_body_too_small_for_two_groups_is_one_group(divisions):
    mesh = am.mesh.structured(am.Rectangle(width=2.0, height=1.0), divisions)
    assert len(volume_groups(mesh, am.PlaneStrain(young=1e6, poisson=0.5))) == 1


@pytest.mark.parametrize("dim", [2, 3])
def test_groups_do_not_depend_on_the_numbers_of_nodes(dim):
    material = three(am.PlaneStrain if dim == 2 else am.Solid)

    def members(mesh):
        means = volume_groups(mesh, material).means
        return {
            frozenset(map(tuple, mesh.points[nodes].round(9)))
            for nodes in np.split(means.indices, means.indptr)
        }

    assert members(glued(dim)) == members(glued(dim, 5))


def wave(points):
    return 1e-2 * (1 + np.cos(5 * points[:, 0]))


def seal(poisson, kind=am.PlaneStrain, law=am.Frictionless(), pair=False):
    """A block squeezed onto a wave, or onto another block that does not match."""
    box = (
        am.Box(width=1.0, depth=1.0, height=0.6)
        if kind is am.Solid
        else am.Rectangle(width=1.0, height=0.6, origin=(0.5, 0.0))
    )
    down = {"z" if kind is am.Solid else "y": -0.01}
    sides = {"x": 0.0, "y": 0.0} if kind is am.Solid else {"x": 0.0}
    if not pair:
        return am.ContactProblem(
            material=kind(young=3e6, poisson=poisson),
            domain=box,
            elements="smoothed",
            law=law,
            contact=am.Contact("bottom", am.GapFunction(wave)),
            supports=(am.Support("top", **{**sides, **down}),),
        )
    below = am.Rectangle(width=1.6, height=0.6, origin=(0.2, -0.6))
    return am.ContactProblem(
        material={"a": kind(young=3e6, poisson=poisson), "b": kind(young=5e6, poisson=0.48)},
        domain=am.Assembly(parts={"a": box, "b": below}),
        elements="smoothed",
        law=law,
        contact=am.ContactPair("a.bottom", "b.top"),
        supports=(am.Support("a.top", **{**sides, **down}), am.Support("b.bottom", x=0.0, y=0.0)),
    )


@cache
def grids(poisson, kind=am.PlaneStrain, law=am.Frictionless(), pair=False):
    divisions = (2, 4) if kind is am.Solid else (3, 6, 12)
    return am.Hierarchy.uniform(
        seal(poisson, kind, law, pair),
        divisions if not pair else [{"a": n, "b": (int(1.5 * n) + 1, n)} for n in divisions],
    )


def whole_matrix(discrete) -> np.ndarray:
    """K = K' + sum A kappa b b', dense."""
    groups = discrete.volumes
    rows = groups.rows.toarray()
    return discrete.matrix.toarray() + (rows.T / (groups.areas * groups.compliance)) @ rows


@cache
def by_least_squares(*posed) -> np.ndarray:
    """The frictionless solution: the contact forces solve a non-negative least-squares problem."""
    discrete = grids(*posed).finest.discrete
    whole, free, dim = whole_matrix(discrete), ~discrete.fixed, discrete.dim
    n = len(discrete.contact)
    normals = np.zeros((n, discrete.n_dofs))
    normals[np.arange(n)[:, None], dim * discrete.contact.nodes[:, None] + np.arange(dim)] = (
        discrete.contact.normals
    )
    rest = (discrete.load - whole @ discrete.fixed_values)[free]
    inverse = np.linalg.inv(whole[np.ix_(free, free)])
    gaps = discrete.contact.gaps - normals @ discrete.fixed_values
    lower = np.linalg.cholesky(normals[:, free] @ inverse @ normals[:, free].T)
    force = nnls(lower.T, np.linalg.solve(lower, normals[:, free] @ inverse @ rest - gaps))[0]
    result = discrete.fixed_values.copy()
    result[free] = inverse @ (rest - normals[:, free].T @ force)
    return result


@pytest.mark.parametrize(
    "posed", [(0.45,), (0.45, am.Solid), (0.45, am.PlaneStrain, am.Frictionless(), True)], ids=str
)
def test_uniform_pressures_go_from_level_to_level(posed):
    coarse, fine = (level.discrete for level in grids(*posed).levels[-2:])
    found = prolonged_pressures(
        coarse, fine, grids(*posed).finest.prolongation, np.full(len(coarse.volumes), 7.0)
    )
    np.testing.assert_allclose(found, 7.0, rtol=1e-12)


METHODS = {
    "truncated": am.Multigrid(rtol=1e-9),
    "nested": am.FullMultigrid(rtol=1e-9),
    "active set": am.ActiveSet(),
    "algebraic active set": am.ActiveSet(linear=am.AMG(), rtol=1e-8),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "posed",
    [
        (0.43,),
        (0.4999,),
        (0.4999, am.Axisymmetric),
        (0.49, am.Solid),
        (0.499, am.PlaneStrain, am.Frictionless(), True),
    ],
    ids=str,
)
def test_every_method_agrees_with_least_squares_on_the_whole_matrix(posed, method):
    discrete, result = grids(*posed).finest.discrete, am.solve(grids(*posed), METHODS[method])
    expected, groups = by_least_squares(*posed), discrete.volumes
    found = discrete.relative(result.displacement).reshape(-1)
    assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max() and not result.fallback
    pressures = groups.strains(expected) / groups.compliance
    assert np.abs(result.pressures - pressures).max() <= 1e-5 * np.abs(pressures).max()
    assert (
        0
        < (result.contact.force_n > 0).sum()
        < len(result.contact) + (discrete.coupling is not None)
    )
    energy = 0.5 * expected @ whole_matrix(discrete) @ expected
    assert result.energy == pytest.approx(energy, rel=1e-6)
    assert 0.5 * np.vdot(result.reaction, result.displacement) == pytest.approx(energy, rel=1e-2)


def with_poisson(problem, poisson):
    material = problem.material
    material = (
        {name: replace(one, poisson=poisson) for name, one in material.items()}
        if isinstance(material, dict)
        else replace(material, poisson=poisson)
    )
    return replace(problem, material=material, elements="smoothed")


HARD = {
    "graded bar": lambda nu: am.Hierarchy.graded(
        with_poisson(am.cases.greco_bar(), nu), (10e-3, 5e-3, 2.5e-3), 4
    ),
    "block": lambda nu: am.Hierarchy.uniform(with_poisson(am.cases.greco_block(), nu), (2, 4, 8)),
    "dovetail": lambda nu: am.Hierarchy.graded(
        with_poisson(am.cases.dovetail(), nu), (8e-3, 4e-3, 2e-3)
    ),
}


@pytest.mark.parametrize("poisson", [0.4999, 0.5])
@pytest.mark.parametrize("case", HARD)
def test_cycles_do_not_depend_on_poissons_ratio_and_the_certificate_holds(case, poisson):
    hierarchy = HARD[case](poisson)
    exact, discrete = am.solve(hierarchy, am.ActiveSet()), hierarchy.finest.discrete
    u = discrete.relative(exact.displacement).reshape(-1)
    size = u @ (discrete.matrix @ u) + discrete.volumes.energy(exact.pressures)
    for solver in (am.Multigrid(rtol=1e-7), am.FullMultigrid(rtol=1e-7)):
        result = am.solve(hierarchy, solver)
        assert not result.fallback and result.cycles <= 22 - 3 * isinstance(
            solver, am.FullMultigrid
        )
        e = discrete.relative(result.displacement).reshape(-1) - u
        error = e @ (discrete.matrix @ e) + discrete.volumes.energy(
            result.pressures - exact.pressures
        )
        assert 0.3 <= result.checked.energy_error / np.sqrt(error / size) <= 2


@pytest.mark.parametrize(
    ("poisson", "solver"), [(0.49, am.Multigrid(rtol=1e-7)), (0.4999, am.ActiveSet())], ids=str
)
def test_the_mean_pressure_of_an_enclosed_body_costs_no_cycles(poisson, solver):
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e6, poisson=poisson),
        domain=am.Rectangle(width=1.0, height=1.0),
        elements="smoothed",
        law=am.Coulomb(0.3),
        supports=(am.Support("left", x=0.0), am.Support("top", x=0.0, y=-0.01)),
        contact=(
            am.Contact("bottom", am.Plane((0, 0), (0, 1))),
            am.Contact("right", am.Plane((1, 0), (-1, 0))),
        ),
    )
    result = am.solve(am.Hierarchy.uniform(problem, (4, 8, 16, 32)), solver)
    assert not result.fallback and result.cycles <= (25 if isinstance(solver, am.Multigrid) else 60)


@pytest.mark.parametrize(
    "posed", [(0.4999, am.PlaneStrain, am.Coulomb(0.3), True), (0.5, am.Solid)], ids=str
)
def test_the_certificate_sees_wrong_pressures_and_displacements(posed):
    discrete, result = grids(*posed).finest.discrete, am.solve(grids(*posed), am.ActiveSet())
    rng = np.random.default_rng(1)
    size = np.abs(result.pressures).max()
    wrong = result.pressures + 1e-4 * size * rng.standard_normal(len(result.pressures))
    assert (
        certify(discrete, result.displacement, result.contact, pressures=wrong)[
            "equilibrium"
        ].relative
        > 1e-5
    )
    bent = result.displacement + 1e-4 * np.abs(result.displacement).max() * rng.standard_normal(
        result.displacement.shape
    ) * ~discrete.fixed.reshape(result.displacement.shape)
    found, exact = (
        certify(discrete, bent, result.contact, bound=bound, pressures=result.pressures)
        for bound in (False, True)
    )
    assert (
        found["volumes"].relative > 1e-5 and 0.5 <= found.energy_error / exact.energy_error <= 1.2
    )
    u, e = (
        discrete.relative(one).reshape(-1)
        for one in (result.displacement, bent - result.displacement)
    )
    size = u @ (discrete.matrix @ u) + discrete.volumes.energy(result.pressures)
    assert 0.95 <= exact.energy_error / np.sqrt(e @ (discrete.matrix @ e) / size) <= 1.4


def test_the_certificate_follows_friction_that_the_pressure_drags():
    hierarchy = am.Hierarchy.uniform(with_poisson(am.cases.greco_bar(), 0.45), (4, 8, 16))
    result = am.solve(hierarchy, am.Multigrid(rtol=1e-3))
    exact = result.certificate(hierarchy.finest.discrete, bound=True)
    assert result.certificate(hierarchy.finest.discrete).energy_error == pytest.approx(
        exact.energy_error, rel=0.05
    )


def test_the_certificate_sees_that_a_body_should_touch():
    hierarchy = am.Hierarchy.uniform(with_poisson(am.cases.greco_bar(), 0.4999), (4, 8))
    discrete, contact = hierarchy.finest.discrete, am.solve(hierarchy, am.ActiveSet()).contact
    apart = replace(
        contact, force_n=0 * contact.force_n, force_t=0 * contact.force_t, state=0 * contact.state
    )
    found = certify(
        discrete, np.zeros(discrete.n_dofs), apart, pressures=np.zeros(len(discrete.volumes))
    )
    assert found.energy_error >= 0.99


def test_the_force_of_a_rubber_roller():
    domain = quarter_cylinder(25e-3, 11e-3, above=True)
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=3e6, poisson=0.4999),
        domain=domain,
        elements="smoothed",
        law=am.Frictionless(),
        contact=am.Contact("contact", am.Plane((0, 0), (0, 1))),
        supports=(am.Support("symmetry", x=0.0), am.Support("top", y=-0.35e-3)),
    )
    result = am.solve(am.Hierarchy.graded(problem, (6e-3, 3e-3, 1.5e-3), 6))
    force = 2 * result.resultant().force[1]
    assert force == pytest.approx(672.7, rel=5e-3)  # by elements of second order
    hertz = np.sqrt(force * 3e6 / (1 - 0.4999**2) / (np.pi * 25e-3))
    half_width = 2 * force / (np.pi * hertz)
    # by the mean: the pressure of the node on the axis alone depends on the mesh
    contact = result.contact
    x = result.mesh.points[contact.node, 0] / half_width
    inner = x < 0.5
    expected = contact.measures[inner] @ (hertz * np.sqrt(1 - x[inner] ** 2))
    assert contact.measures[inner] @ contact.pressure[inner] == pytest.approx(expected, rel=3e-3)


PATH = am.LoadPath({"top": [0.4, 1.0, 0.6]})
ON_PATH = {
    "nested": am.FullMultigrid(rtol=1e-9),
    "from zero": am.Multigrid(rtol=1e-9),
    "active set": am.ActiveSet(),
}


@pytest.mark.parametrize("method", ON_PATH)
def test_load_paths_carry_pressures_from_step_to_step(method, tmp_path):
    problem = with_poisson(am.cases.greco_bar(law=am.Coulomb(0.4)), 0.4999)
    hierarchy = am.Hierarchy.uniform(problem, (3, 6, 12))
    steps = resumed(hierarchy, PATH, ON_PATH[method], tmp_path, after=1)
    expected = am.solve_path(hierarchy, PATH, am.ActiveSet(condensed=False))
    for result, other in zip(steps, expected, strict=True):
        assert (
            np.abs(result.displacement - other.displacement).max()
            <= 1e-6 * np.abs(other.displacement).max()
        )


def test_the_first_step_of_a_path_has_the_pressures_of_its_nested_start():
    problem = with_poisson(am.cases.greco_bar(law=am.Coulomb(0.4)), 0.4999)
    hierarchy, solver = am.Hierarchy.uniform(problem, (3, 6, 12)), am.FullMultigrid(rtol=1e-6)
    first = am.solve_path(hierarchy, am.LoadPath(), solver)[0]
    # from pressures of zero it takes four more
    assert first.cycles <= am.solve(hierarchy, solver).cycles + 1


def test_a_start_without_pressures_begins_with_none():
    here = grids(0.45)
    result = am.solve(here)
    given = replace(result, pressures=np.zeros(0))
    started = [am.solve(here, am.Multigrid(), start=one) for one in (given, result.displacement)]
    assert started[0].cycles == started[1].cycles > 2
    assert am.solve(here, am.Multigrid(), start=result).cycles <= 2


def test_adaptive_loops_start_from_the_pressures_of_the_step_before():
    last, multigrid = None, am.Multigrid(rtol=1e-6)
    for last in am.adapt(seal(0.4999), start=0.2, max_nodes=400):
        assert (
            last.result.status.ok
            and not last.result.fallback
            and last.result.cycles <= 20 + 10 * (last.number == 0)
        )
    from_zero = am.solve(last.hierarchy, multigrid).cycles
    assert last.number > 0 and last.result.cycles <= 0.85 * from_zero
    assert am.solve(last.hierarchy, multigrid, start=last.result).cycles <= 2


class Forgetful:
    """A solver that returns no pressures."""

    def run(self, hierarchy, run, start):
        return Outcome(np.zeros(hierarchy.finest.discrete.n_dofs), am.Status.CONVERGED, 1, 1e-8)


def rubber(**parts):
    return replace(am.cases.greco_bar(), material=am.PlaneStrain(young=1e6, poisson=0.5), **parts)


test_refusals = refused(
    (lambda: rubber(), "poisson must be less than 0.5 with linear elements"),
    (
        lambda: am.solve(grids(0.45), am.SingleGrid()),
        "SingleGrid cannot solve for smoothed elements with poisson",
    ),
    (
        lambda: am.solve(grids(0.45), am.Multigrid(correction=am.Monotone())),
        "correction Monotone cannot solve",
    ),
    (
        lambda: am.solve(grids(0.45), am.FullMultigrid(correction=am.PaperCorrection())),
        "PaperCorrection cannot solve",
    ),
    (
        lambda: am.solve(grids(0.45), am.ActiveSet(nested_start=True)),
        "nested start of ActiveSet cannot solve for smoothed elements",
    ),
    (lambda: am.solve(grids(0.45), Forgetful()), TypeError, "pressures of .* volumes"),
    (lambda: replace(grids(0.45).finest.discrete, volumes="none"), TypeError, "volumes must be"),
    (
        lambda: am.solve(
            grids(0.45), am.Multigrid(), start=replace(am.solve(grids(0.45)), pressures=np.zeros(3))
        ),
        "start.pressures must have shape",
    ),
    (
        lambda: replace(am.solve(grids(0.45)), pressures=np.zeros(0)).certificate(
            grids(0.45).finest.discrete
        ),
        "problem has .* volumes",
    ),
)


def test_a_problem_of_a_user_has_volumes(tmp_path):
    discrete = grids(0.49).finest.discrete
    names = "rows", "means", "areas", "compliance", "modulus", "body", "corners"
    parts = {name: getattr(discrete.volumes, name) for name in names}
    own = am.DiscreteProblem(
        matrix=discrete.matrix,
        load=discrete.load,
        fixed=discrete.fixed,
        law=discrete.law,
        contact=discrete.contact,
        fixed_values=discrete.fixed_values,
        coordinates=discrete.coordinates,
        volumes=Volumes(**parts),
    )
    result, expected = am.solve(own), am.solve(grids(0.49), am.ActiveSet())
    np.testing.assert_allclose(result.displacement, expected.displacement, rtol=0, atol=1e-9)
    result.save(tmp_path / "own.npz")
    assert np.array_equal(am.Result.load(tmp_path / "own.npz").pressures, result.pressures)


@pytest.mark.parametrize("poisson", [0.45, 0.5])
@EACH_KIND
def test_a_heated_body_between_walls_floats_on_its_obstacle_with_the_stress_of_the_closed_form(
    kind, poisson
):
    heat, pressure, mu = 1e-3, 1e3, 1.5e6 / (1 + poisson)
    box = seal(poisson, kind).domain
    walls = {"left": "x", "right": "x"} | ({"front": "y", "back": "y"} if kind is am.Solid else {})
    problem = am.ContactProblem(
        material=kind(young=3e6, poisson=poisson),
        domain=box,
        elements="smoothed",
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0.0,) * box.dim, (0.0,) * (box.dim - 1) + (1.0,))),
        loads=(am.InitialStrain("body", (heat,) * 3), am.Pressure("top", pressure)),
        supports=tuple(am.Support(name, **{axis: 0.0}) for name, axis in walls.items()),
    )
    hierarchy = am.Hierarchy.uniform(problem, (2, 4) if kind is am.Solid else (3, 6))
    if poisson < 0.5:
        lame = problem.material.lame
        up = ((3 * lame + 2 * mu) * heat - pressure) / (lame + 2 * mu)
        across = lame * (up - 3 * heat) - 2 * mu * heat
    else:
        up, across = 3 * heat, -pressure - 2 * mu * 3 * heat
    last = box.dim - 1
    results = [
        am.solve(hierarchy, method)
        for method in (am.Multigrid(rtol=1e-10), am.ActiveSet(rtol=1e-10))
    ]
    results.append(
        am.solve_path(hierarchy, am.LoadPath({"body": [0.5, 1.0], "top": [1.0, 1.0]}))[-1]
    )
    for result in results:
        assert result.displacement[:, last].max() == pytest.approx(0.6 * up, rel=1e-7)
        stress = result.stress()
        np.testing.assert_allclose(stress[:, last], -pressure, rtol=1e-6)
        np.testing.assert_allclose(stress[:, [c for c in range(3) if c != last]], across, rtol=1e-6)
    density = 0.5 * (-pressure * (up - heat) - 2 * across * heat)
    volume = {am.PlaneStrain: 0.6, am.Axisymmetric: 2 * np.pi * 0.6, am.Solid: 0.6}[kind]
    assert results[0].energy == pytest.approx(density * volume, rel=1e-7)


def test_steps_of_a_path_expand_by_their_strain():
    def heated(heat):
        problem = replace(seal(0.45), loads=am.InitialStrain("body", (heat,) * 3))
        return am.Hierarchy.uniform(problem, (3, 6))

    for step, heat in zip(
        am.solve_path(heated(-4e-3), am.LoadPath({"body": [0.5, 1.0]})), (-2e-3, -4e-3), strict=True
    ):
        assert far(step, am.solve(heated(heat), am.ActiveSet(rtol=1e-10))) <= 1e-6


def test_the_limit_on_steps_holds_for_all_solves_of_the_active_set_method():
    whole = am.solve(grids(0.49999), am.ActiveSet())
    result = am.solve(grids(0.49999), am.ActiveSet(max_steps=whole.cycles - 2), throw=False)
    assert result.status is am.Status.LIMIT and result.cycles <= whole.cycles - 2
