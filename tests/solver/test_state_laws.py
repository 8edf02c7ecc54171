"""Friction that depends on pressure and slip, and surfaces that give way to the pressure, in
proportion or by a power law."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import EXACT, bar_hierarchy, bar_on_block, rotation, turned
from norms import distance, far
from paths import resumed
from refused import refused
from scipy.optimize import root

import adaptmg as am
from adaptmg.solver.certificate import certify

FINE = am.FullMultigrid(rtol=1e-10)
METHODS = (FINE, EXACT, am.SingleGrid(omega=1.7, rtol=1e-10))
IDS = ("full", "active set", "single grid")
SOFT = am.NormalCompliance(2e-13)
PRESSURE, YOUNG = 5e7, 1e11


def as_soft_as(compliance, exponent):
    """Return a layer that yields as a linear one of this compliance does, at PRESSURE."""
    return am.NormalCompliance(compliance * PRESSURE ** (1 - 1 / exponent), exponent=exponent)


#: yield as SOFT does at PRESSURE, by its square root, and by a higher root
CURVED, STIFFENING = (as_soft_as(2e-13, m) for m in (2, 7.5))
LAYERS = pytest.mark.parametrize("layer", [SOFT, CURVED, STIFFENING], ids=("1", "2", "7.5"))
#: dimension, turn and shift
PLANE, SPACE = (2, 0.4, (0.3, -0.2)), (3, (0.2, -0.3, 0.5), (0.1, 0.2, -0.1))


def falling(pressure, slip):
    """Return the friction of a surface whose roughness is pressed flat, and worn."""
    return (0.1 + 0.4 / (1 + pressure / 5e7)) * (0.7 + 0.3 * np.exp(-slip / 1e-5))


def test_friction_next_to_a_held_node_is_that_of_its_pressure():
    """The corner is held with the strain of a uniform pressure; the next node takes over its part."""
    rng = np.random.default_rng(3)
    size, shift = rng.uniform(0.1, 10.0), rng.normal(size=2)
    mesh = am.mesh.structured(am.Rectangle(width=size, height=size), (8, 6))
    order = rng.permutation(mesh.n_nodes)  # the new number of each node
    points = np.empty_like(mesh.points)
    points[order] = mesh.points + shift
    mesh = replace(mesh, points=points, elements=order[mesh.elements], facets=order[mesh.facets])
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=YOUNG, poisson=0.0),
        law=am.StateLaw(falling),
        contact=am.Contact("bottom", am.Plane(tuple(shift), (0, 1))),
        loads=am.Pressure("top", PRESSURE),
        supports=am.Support("left", x=0, y=lambda x: -PRESSURE / YOUNG * (x[:, 1] - shift[1])),
    )
    for method in (EXACT, am.SingleGrid(rtol=1e-10)):
        contact = am.solve(am.Hierarchy.from_meshes(problem, mesh), method).contact
        assert contact.measures.max() > 1.4 * np.median(contact.measures)
        assert contact.pressure == pytest.approx(PRESSURE, rel=1e-8)
        friction = contact.limit / contact.force_n
        assert friction == pytest.approx(falling(PRESSURE, 0.0), rel=1e-8)


def block(law, place=PLANE, compliance=None, push=1e8, poisson=0.2):
    """Return grids of a block pressed on a plane and pushed along it."""
    dim, turn, shift = place
    domain = (
        am.Rectangle(width=0.04, height=0.04)
        if dim == 2
        else am.Box(width=0.04, depth=0.02, height=0.02)
    )
    divisions = (4, 8, 16) if dim == 2 else ((4, 2, 2), (8, 4, 4))
    meshes = [turned(am.mesh.structured(domain, n), turn) for n in divisions]
    meshes = [replace(mesh, points=mesh.points + np.array(shift)) for mesh in meshes]
    up = rotation(turn) @ np.eye(dim)[dim - 1]
    problem = am.ContactProblem(
        material=(am.PlaneStrain if dim == 2 else am.Solid)(young=YOUNG, poisson=poisson),
        law=law,
        contact=am.Contact("bottom", am.Plane(shift, tuple(up)), compliance=compliance),
        loads=(am.Pressure("top", PRESSURE), am.Pressure("left", push)),
        supports=[am.Support(name, normal=0) for name in ("right", "back")[: dim - 1]],
    )
    return am.Hierarchy.from_meshes(problem, meshes)


def given(grids, friction):
    """Return the same grids with given coefficients at the nodes of the finest level."""
    discrete = grids.finest.discrete.posing(law=am.Coulomb(friction))
    return replace(grids, levels=(*grids.levels[:-1], grids.finest.posing(discrete=discrete)))


@pytest.mark.parametrize("place", [PLANE, SPACE, None], ids=("plane", "space", "pair"))
def test_coefficient_is_the_fixed_point_of_problems_with_given_ones(place):
    law = am.StateLaw(falling)
    grids = block(law, place) if place else bar_hierarchy(bar_on_block(law))
    result = am.solve(grids, FINE)
    friction = falling(result.contact.pressure, np.linalg.norm(result.contact.slip, axis=1))
    outer = am.solve(given(grids, friction), EXACT).contact
    assert outer.counts()["slip"] > 3
    for name in ("force_n", "force_t", "slip"):
        expected = getattr(outer, name)
        size = np.abs(expected).max()
        np.testing.assert_allclose(getattr(result.contact, name), expected, atol=1e-8 * size)
    assert not result.certificate().contradictions(1e-9)
    assert result.cycles <= am.solve(given(grids, friction), FINE).cycles + 2


@pytest.mark.parametrize("method", [*METHODS[1:], am.Multigrid(correction=am.Monotone())])
def test_methods_agree(method):
    grids = block(am.StateLaw(falling))
    assert far(am.solve(grids, method), am.solve(grids, FINE)) <= 1e-7


def test_slips_along_supports_that_move_count():
    grids = block(am.StateLaw(falling), (3, np.zeros(3), (0.0, 0.0, 0.0)))
    moving = [am.Support(name, y=1e-5) for name in ("front", "back")]
    problem = replace(grids.problem, supports=[am.Support("right", x=0), *moving])
    results = [am.solve(grids.with_problem(problem), method) for method in METHODS[:2]]
    friction = [result.contact.limit / result.contact.force_n for result in results]
    np.testing.assert_allclose(friction[0], friction[1], rtol=1e-7)
    slip = np.linalg.norm(results[0].contact.slip, axis=1)
    np.testing.assert_allclose(friction[0], falling(results[0].contact.pressure, slip))


@pytest.mark.parametrize("place", [PLANE, SPACE], ids=("plane", "space"))
def test_friction_that_rises_steeply_with_the_slip_needs_no_other_method(place):
    grids = block(am.StateLaw(lambda p, s: 0.4 - 0.2 * np.exp(-s / 2e-7)), place)
    result = am.solve(grids, FINE)
    assert result.contact.counts()["slip"] and not result.fallback
    assert far(result, am.solve(grids, EXACT)) <= 1e-8


def wearing(pressure, slip):
    """Return friction so low that its moment does not lift an edge."""
    return 0.002 + 0.004 * np.exp(-slip / 2e-2)


def dragged(friction=wearing):
    """Return grids of a nearly rigid block, pressed on a plane and dragged to and fro."""
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.1, height=0.01),
        material=am.PlaneStrain(young=1e12, poisson=0.0),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1)), law=am.StateLaw(friction)),
        loads=[am.Pressure("top", 1e6)],
        supports=[am.Support("top", x=1e-2, name="drag")],
    )
    return am.Hierarchy.uniform(problem, divisions=[(10, 1), (20, 2)])


PLACES = [0.5, 1.0, 2.0, 1.5, 0.0, 1.0]
DRAG = am.LoadPath({"drag": PLACES})


@pytest.mark.parametrize("method", [FINE, am.ActiveSet(rtol=1e-7)], ids=IDS[:2])
def test_friction_of_a_rigid_block_falls_with_its_path(method):
    moves = 1e-2 * np.diff(PLACES, prepend=0.0)
    expected = -np.sign(moves) * 1e5 * wearing(0.0, np.cumsum(np.abs(moves)))
    forces = [step.resultant("contact").force[0] for step in am.solve_path(dragged(), DRAG, method)]
    np.testing.assert_allclose(forces, expected, rtol=2e-5)


def test_stored_paths_go_on_with_the_slips_so_far(tmp_path):
    resumed(dragged(), DRAG, None, tmp_path, after=2)
    with pytest.raises(ValueError, match="law differs"):
        am.solve_path(dragged(lambda p, s: wearing(p, 1.1 * s)), DRAG, store=tmp_path)


@pytest.mark.parametrize("method", METHODS, ids=IDS)
@pytest.mark.parametrize("place", [PLANE, SPACE], ids=("plane", "space"))
@LAYERS
def test_column_sinks_by_its_shortening_and_the_layer(place, method, layer):
    grids = block(am.Frictionless(), place, layer, push=0.0, poisson=0.0)
    result = am.solve(grids, replace(method, rtol=1e-12))
    mesh = grids.finest.mesh
    top = result.displacement[mesh.boundary_nodes("top")] @ result.contact.normal[0]
    height = (0.04, 0.02)[place[0] - 2]
    depth = SOFT.compliance * PRESSURE
    np.testing.assert_allclose(top, PRESSURE * height / YOUNG + depth, rtol=1e-9)
    np.testing.assert_allclose(-result.contact.gap, depth, rtol=1e-9)


@cache
def layered(body, compliance, method, law=am.Coulomb(0.4)):
    if body == "obstacle":
        return am.solve(block(law, PLANE, compliance, 3e7), method)
    problem = bar_on_block(law)
    pairs = tuple(replace(pair, compliance=compliance) for pair in problem.contact)
    return am.solve(bar_hierarchy(replace(problem, contact=pairs), 2), method)


@pytest.mark.parametrize("body", ["obstacle", "pair"])
@LAYERS
def test_stiffer_layers_tend_to_rigid_surfaces_to_first_order(body, layer):
    rigid = layered(body, None, EXACT).displacement
    moved = [
        layered(body, replace(layer, compliance=c * layer.compliance), EXACT).displacement - rigid
        for c in (5e-4, 5e-5)
    ]
    assert np.linalg.norm(moved[0]) == pytest.approx(10 * np.linalg.norm(moved[1]), rel=0.05)
    found = layered(body, layer, FINE)
    assert far(found, layered(body, layer, EXACT)) <= 1e-8
    assert found.cycles <= layered(body, None, FINE).cycles + 2
    assert not found.certificate().contradictions(1e-9)


def on_a_dome(place, layer, law, diameter=10):
    """Return grids of a block pressed on a dome, which touches it in part."""
    grids = block(law, place, layer, push=2e7, poisson=0.3)
    part = grids.problem.contact[0]
    along = rotation(place[1]) @ np.eye(place[0])[0]
    obstacle = am.GapFunction(lambda x: ((x - place[2]) @ along - 0.02) ** 2 / diameter)
    return grids.with_problem(replace(grids.problem, contact=replace(part, obstacle=obstacle)))


@cache
def on_a_soft_dome(place, method):
    return am.solve(on_a_dome(place, SOFT, am.Frictionless()), method)


@pytest.mark.parametrize("place", [PLANE, SPACE], ids=("plane", "space"))
@LAYERS
def test_layers_agree_with_a_dense_solve(place, layer):
    grids = on_a_dome(place, layer, am.Frictionless())
    discrete = grids.finest.discrete
    contact = discrete.contact
    dofs = discrete.dim * contact.nodes[:, None] + np.arange(discrete.dim)
    inside = np.setdiff1d(np.flatnonzero(~discrete.fixed), dofs)
    near = np.setdiff1d(np.flatnonzero(~discrete.fixed), inside)
    # the inside follows what is near the surface
    matrix = discrete.decoupled_rows.matrix.toarray()
    follows = np.linalg.solve(matrix[np.ix_(inside, inside)], matrix[np.ix_(inside, near)])
    free_load = discrete.free_part(discrete.load)
    load = free_load[near] - free_load[inside] @ follows
    matrix = matrix[np.ix_(near, near)] - matrix[np.ix_(near, inside)] @ follows
    rows = np.zeros((len(contact), discrete.n_dofs))
    np.put_along_axis(rows, dofs, contact.normals, axis=1)
    rows = rows[:, near]

    def residual(u):
        depth = np.maximum(rows @ u - contact.gaps, 0) / layer.compliance
        forces = contact.weights * depth**layer.exponent
        slopes = (depth > 0) * layer.exponent * depth ** (layer.exponent - 1) / layer.compliance
        tangent = matrix + rows.T @ ((contact.weights * slopes)[:, None] * rows)
        return matrix @ u + rows.T @ forces - load, tangent

    start = on_a_soft_dome(place, EXACT).displacement.reshape(-1)
    solution = root(residual, start[near], jac=True, options={"xtol": 1e-14})
    expected = contact.gaps - rows @ solution.x
    found = am.solve(grids, FINE)
    assert found.contact.counts()["open"] and found.contact.closed.sum() > 4
    np.testing.assert_allclose(found.contact.gap, expected, atol=1e-8 * np.abs(expected).max())
    assert found.cycles <= on_a_soft_dome(place, FINE).cycles + 2


def test_sweeps_of_a_single_grid_find_how_deep_a_soft_surface_yields():
    """They begin where hardly any node touches."""
    grids = on_a_dome(SPACE, as_soft_as(1e-10, 20), am.Frictionless())
    found = am.solve(grids, am.SingleGrid(omega=1.9, rtol=1e-8))
    assert far(found, am.solve(grids, am.ActiveSet(rtol=1e-10))) <= 1e-6


@pytest.mark.parametrize("layer", [am.NormalCompliance(2e-14), am.NormalCompliance(2e-10, 2)])
def test_a_punch_without_other_loads_slides_on_a_layer(layer):
    shape = am.GapFunction(lambda x: (x[:, 0] - 0.02) ** 2 / 0.1)
    slide = am.Moving(shape, displacement=(4e-6, 0), name="slide")
    punch = am.Rigid(slide, force=(None, -1e6), moment=None, name="punch")
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.04, height=0.04),
        material=am.PlaneStrain(young=2.1e11, poisson=0.3),
        contact=am.Contact("top", punch, compliance=layer),
        law=am.Coulomb(0.3),
        supports=[am.Support("bottom", x=0, y=0)],
    )
    grids = am.Hierarchy.graded(problem, sizes=(8e-3, 4e-3, 2e-3), contact_ratio=8)
    path = am.LoadPath({"punch": [0.1, 1, 1], "slide": [0, 0, 1]})
    forces = [
        am.solve_path(grids, path, method)[-1].resultant("top").force for method in METHODS[:2]
    ]
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-6)


def test_stored_paths_go_on_with_the_layer(tmp_path):
    grids = on_a_dome(PLANE, CURVED, am.Coulomb(0.4))
    pressed = [replace(load, name=load.boundary) for load in grids.problem.loads]
    grids = grids.with_problem(replace(grids.problem, loads=pressed))
    path = am.LoadPath({"top": [0.2, 1, 1, 0.3], "left": [0, 0.5, 1, 0]})
    for step in resumed(grids, path, FINE, tmp_path, after=1):
        pressure = (np.minimum(step.contact.gap, 0) / CURVED.compliance) ** 2
        np.testing.assert_allclose(step.contact.pressure, pressure, atol=1e-8 * PRESSURE)
        assert not step.certificate().contradictions(1e-9)
    contact = replace(grids.problem.contact[0], compliance=replace(CURVED, exponent=2.1))
    other = grids.with_problem(replace(grids.problem, contact=contact))
    with pytest.raises(ValueError, match="contact differs"):
        am.solve_path(other, path, FINE, store=tmp_path)


@LAYERS
def test_layers_meet_at_a_corner(layer):
    grids = block(am.Coulomb(0.3), PLANE, layer, push=5e7, poisson=0.3)
    turn = rotation(PLANE[1])
    wall = am.Plane(tuple(PLANE[2] + turn @ (0.04, 0)), tuple(turn @ (-1, 0)))
    contacts = (*grids.problem.contact, am.Contact("right", wall, compliance=SOFT))
    posed = replace(grids.problem, contact=contacts, supports=())
    again = am.Hierarchy.from_meshes(posed, [level.mesh for level in grids.levels])
    contact = am.solve(again, FINE).contact
    assert (contact.measures > 1.1 * contact.weights).any()  # next to the corner
    for k, of_boundary in enumerate((layer, SOFT)):
        at = contact.closed & (contact.boundary == k)
        depth = of_boundary.compliance * contact.pressure[at] ** (1 / of_boundary.exponent)
        np.testing.assert_allclose(-contact.gap[at], depth, atol=1e-8 * depth.max())


@LAYERS
def test_layers_go_with_friction_that_depends_on_pressure(layer):
    contact = layered("obstacle", layer, FINE, am.StateLaw(falling)).contact
    depth = layer.compliance * contact.pressure ** (1 / layer.exponent)
    np.testing.assert_allclose(-contact.gap, depth, rtol=1e-6)
    expected = falling(contact.pressure, np.linalg.norm(contact.slip, axis=1)) * contact.force_n
    np.testing.assert_allclose(contact.limit, expected, rtol=1e-6)


@pytest.mark.parametrize("layer", [am.NormalCompliance(4e-13), replace(CURVED, exponent=1.999)])
def test_certificate_refuses_the_solution_of_another_layer(layer):
    other = layered("obstacle", layer, EXACT)
    layer = SOFT if layer.exponent == 1 else CURVED
    discrete = block(am.Coulomb(0.4), PLANE, layer, 3e7).finest.discrete
    checked = certify(discrete, other.displacement, other.contact)
    assert "penetration" in checked.contradictions(1e-8)


@pytest.mark.parametrize("exponent", [1, 2, 20])
def test_certificate_estimates_the_error_next_to_soft_surfaces(exponent):
    """After a cycle nodes are open that will touch, and a small force closes their gaps."""
    grids = on_a_dome(SPACE, as_soft_as(1e-11, exponent), am.Coulomb(0.4))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-10)).displacement
    found = am.solve(grids, am.Multigrid(max_cycles=1), throw=False)
    error = distance(grids.finest.discrete, found.displacement, exact)
    assert 0.8 * error <= found.certificate().energy_error <= 1.3 * error


def test_certificate_allows_that_forces_of_rounding_move_a_soft_surface():
    grids = on_a_dome(PLANE, as_soft_as(3e-11, 30), am.Coulomb(0.4), 0.2)
    assert am.solve(grids, am.ActiveSet(rtol=1e-11)).checked.energy_error < 1e-11


@pytest.mark.parametrize(
    ("friction", "words"),
    [
        (lambda p, s: 0.5 * np.exp(-p / 2e7), "falls with the pressure"),
        (lambda p, s: 0.2 + 0.6 * np.exp(-s / 1e-7), "falls with the slip"),
        # the slope of friction over pressure is 20 at PRESSURE, and 0 without pressure
        (lambda p, s: 10 * p / PRESSURE, "a slope of friction over pressure of .* exceeds"),
        (lambda p, s: 20.0 + 0 * p, "friction 20 exceeds"),
    ],
    ids=("pressure", "slip", "rise", "everywhere"),
)
def test_doubtful_laws_are_warned_of(friction, words):
    with pytest.warns(RuntimeWarning, match=words):
        am.solve(block(am.StateLaw(friction)), throw=False)


class UserDefined:
    setup = None.__init__


def solved(method, **options):
    return lambda: am.solve(block(am.StateLaw(falling), **options), method)


test_refused = refused(
    (lambda: am.StateLaw(0.3), TypeError, "function of pressures and slips"),
    (lambda: am.StateLaw(lambda p, s: 0.5 - 1e-9 * p), "friction.* must be >= 0.*numpy.maximum"),
    (lambda: am.StateLaw(lambda p, s: 0.3), "shape"),
    (
        lambda: am.StateLaw(lambda p: 0.3 * p),
        TypeError,
        r"two arguments.* slips in m, got one of \(p\)",
    ),
    (solved(UserDefined()), "user-defined method cannot follow a StateLaw; use"),
    (solved(am.SingleGrid(stop="change")), 'stop="error"'),
    (lambda: am.NormalCompliance(-1e-13), "compliance must be"),
    (lambda: am.NormalCompliance(1e-9, exponent=0.5), "exponent must be >= 1, got 0.5: a layer"),
    (
        lambda: am.ContactNodes(nodes=[0], normals=[[0, 1]], gaps=[0], exponent=[np.nan]),
        "exponent must be",
    ),
    (
        lambda: am.solve(on_a_dome(PLANE, CURVED, am.Coulomb(0.3)), UserDefined()),
        "user-defined method cannot follow a NormalCompliance with an exponent above 1; use",
    ),
    (solved(am.Multigrid(correction=am.Monotone()), compliance=SOFT), "correction=am.Truncated"),
)
