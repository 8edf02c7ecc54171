"""Friction that depends on pressure and slip."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT, bar_hierarchy, bar_on_block, rotation, turned
from refused import refused

import adaptmg as am


def falling(pressure, slip):
    """Of a surface whose roughness is pressed flat, and worn."""
    return (0.1 + 0.4 / (1 + pressure / 5e7)) * (0.7 + 0.3 * np.exp(-slip / 1e-5))


def pushed(law, turn, shift, dim):
    """A block pressed on a plane and pushed along it, turned and shifted; meshes, and a problem."""
    domain = (
        am.Rectangle(width=0.04, height=0.04)
        if dim == 2
        else am.Box(width=0.04, depth=0.02, height=0.02)
    )
    meshes = [
        turned(am.mesh.structured(domain, n), turn)
        for n in ((4, 8, 16) if dim == 2 else ((4, 2, 2), (8, 4, 4)))
    ]
    meshes = [replace(mesh, points=mesh.points + shift) for mesh in meshes]
    up = rotation(turn) @ np.eye(dim)[dim - 1]
    return meshes, am.ContactProblem(
        material=am.PlaneStrain(young=1e11, poisson=0.2)
        if dim == 2
        else am.Solid(young=1e11, poisson=0.2),
        law=law,
        contact=am.Contact("bottom", am.Plane(tuple(shift), tuple(up))),
        loads=(am.Pressure("top", 5e7), am.Pressure("left", 1e8)),
        supports=[am.Support(name, normal=0) for name in ("right", "back")[: dim - 1]],
    )


def grids_on(law, kind):
    if kind == "pair":
        return bar_hierarchy(bar_on_block(law))
    dim, turn, shift = kind
    meshes, problem = pushed(law, turn, np.array(shift), dim)
    return am.Hierarchy.from_meshes(problem, meshes)


def nodal(discrete, friction):
    """The same problem with coefficients by node."""
    return discrete.posing(law=am.Coulomb(friction))


PLACES = (
    (2, 0.4, (0.3, -0.2)),
    (3, (0.2, -0.3, 0.5), (0.1, 0.2, -0.1)),
    "pair",
)


@pytest.mark.parametrize("kind", PLACES, ids=("plane", "space", "pair"))
def test_coefficient_is_the_fixed_point_of_problems_with_given_ones(kind):
    grids = grids_on(am.StateLaw(falling), kind)
    result = am.solve(grids, am.FullMultigrid(rtol=1e-10))
    discrete = grids.finest.discrete
    friction = np.full(len(discrete.contact), 0.3)
    for _ in range(40):
        outer = am.solve(nodal(discrete, friction), EXACT).contact
        friction = falling(outer.pressure, np.linalg.norm(outer.slip, axis=1))
    assert outer.counts()["slip"] > 3
    for name in ("force_n", "force_t", "slip"):
        expected = getattr(outer, name)
        np.testing.assert_allclose(
            getattr(result.contact, name), expected, rtol=0, atol=1e-8 * np.abs(expected).max()
        )
    assert not result.certificate().contradictions(1e-9)
    given = am.Hierarchy(
        (*grids.levels[:-1], grids.finest.posing(discrete=nodal(discrete, friction))),
        grids.problem,
        grids.origin,
    )
    assert result.cycles <= am.solve(given, am.FullMultigrid(rtol=1e-10)).cycles + 2


@pytest.mark.parametrize(
    "method",
    [
        EXACT,
        am.SingleGrid(omega=1.5, rtol=1e-9),
        am.Multigrid(correction=am.Monotone(), rtol=1e-9),
    ],
    ids=("active set", "single grid", "monotone"),
)
def test_methods_agree(method):
    grids = grids_on(am.StateLaw(falling), PLACES[0])
    expected = am.solve(grids, am.FullMultigrid(rtol=1e-10)).displacement
    found = am.solve(grids, method).displacement
    assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()


def test_turned_geometry_has_the_same_pressures():
    forces = [
        am.solve(grids_on(am.StateLaw(falling), (2, turn, shift)), EXACT).contact.force_n
        for turn, shift in ((0.0, (0.0, 0.0)), (2.1, (1.0, 3.0)))
    ]
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-7)


# so little that its moment does not lift the edges
LOW, HIGH, LENGTH = 0.002, 0.006, 2e-2


def weakening(pressure, slip):
    return LOW + (HIGH - LOW) * np.exp(-slip / LENGTH)


def dragged(law):
    """A nearly rigid block, pressed on a plane and dragged to and fro."""
    return am.Hierarchy.uniform(
        am.ContactProblem(
            domain=am.Rectangle(width=0.1, height=0.01),
            material=am.PlaneStrain(young=1e12, poisson=0.0),
            contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
            law=law,
            loads=[am.Pressure("top", 1e6)],
            supports=[am.Support("top", x=1e-2, name="drag")],
        ),
        divisions=[(10, 1), (20, 2)],
    )


WAY = am.LoadPath({"drag": [0.5, 1.0, 2.0, 1.5, 0.0, 1.0]})


@pytest.mark.parametrize(
    "method", [am.FullMultigrid(), am.ActiveSet(rtol=1e-7)], ids=("full", "active set")
)
def test_friction_of_a_rigid_block_falls_with_its_way(method):
    steps = am.solve_path(dragged(am.StateLaw(weakening)), WAY, method)
    moves = 1e-2 * np.diff([0.0, 0.5, 1.0, 2.0, 1.5, 0.0, 1.0])
    expected = -np.sign(moves) * 1e5 * weakening(0.0, np.cumsum(np.abs(moves)))
    forces = [step.resultant("contact").force[0] for step in steps]
    np.testing.assert_allclose(forces, expected, rtol=2e-5)


def test_stored_paths_go_on_with_the_slips_so_far(tmp_path):
    whole = am.solve_path(dragged(am.StateLaw(weakening)), WAY)

    def stop(k, result):
        if k == 2:
            raise KeyboardInterrupt

    grids = dragged(am.StateLaw(weakening))
    with pytest.raises(KeyboardInterrupt):
        am.solve_path(grids, WAY, store=tmp_path, callback=stop)
    again = am.solve_path(grids, WAY, store=tmp_path)
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
    other = am.StateLaw(lambda pressure, slip: weakening(pressure, 1.1 * slip))
    with pytest.raises(ValueError, match="law differs"):
        am.solve_path(dragged(other), WAY, store=tmp_path)


def test_boundaries_may_have_such_laws_next_to_others():
    problem = am.cases.greco_bar(law=am.Coulomb(0.3))
    state = am.StateLaw(lambda pressure, slip: 0.3 + 0 * pressure)
    alone = replace(problem, contact=replace(problem.contact[0], law=state))
    expected, found = (
        am.solve(am.Hierarchy.uniform(one, divisions=(4, 8)), EXACT).displacement
        for one in (problem, alone)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_doubtful_laws_are_warned_of():
    for law, words in (
        (lambda p, s: 0.5 * np.exp(-p / 2e7), "falls with the pressure"),
        (lambda p, s: 0.2 + 0.6 * np.exp(-s / 1e-7), "falls with the slip"),
    ):
        grids = grids_on(am.StateLaw(law), PLACES[0])
        with pytest.warns(RuntimeWarning, match=words):
            am.solve(grids, throw=False)


def idle(hierarchy, start):
    raise AssertionError


class Mine:
    setup = staticmethod(idle)


test_refused = refused(
    (lambda: am.StateLaw(0.3), TypeError, "function of pressures and slips"),
    (lambda: am.StateLaw(lambda p, s: 0.5 - 1e-9 * p), "friction.* must be >= 0.*numpy.maximum"),
    (lambda: am.StateLaw(lambda p, s: 0.3), "shape"),
    (
        lambda: am.solve(grids_on(am.StateLaw(falling), PLACES[0]), Mine()),
        "user-defined method cannot follow a StateLaw; use",
    ),
    (
        lambda: am.solve(grids_on(am.StateLaw(falling), PLACES[0]), am.SingleGrid(stop="change")),
        'stop="error"',
    ),
)
