"""Friction at contact nodes of which a support holds a tangential component: a pad held at its sides, a block."""

import numpy as np
import pytest
from bodies import assert_agrees, assert_balanced
from saddle import Parts

import adaptmg as am
from adaptmg.discrete.discretise import discretise

FRICTION, PRESSURE, PULL = 0.4, 1e7, 1e-3
EXACT = am.ActiveSet(rtol=1e-11)


def pad(dim, slave="pad", coupling="mortar", pull=PULL, friction=FRICTION):
    """A pad held at its sides on a plate that is pulled along x."""
    pair = ("pad.bottom", "plate.top") if slave == "pad" else ("plate.top", "pad.bottom")
    if dim == 2:
        parts = {"pad": am.Rectangle(width=40e-3, height=20e-3),
                 "plate": am.Rectangle(width=80e-3, height=20e-3, origin=(-20e-3, -20e-3))}
        below = am.Support("plate.bottom", x=pull, y=0.0)
        material = am.PlaneStrain(young=2.1e11, poisson=0.3)
    else:
        parts = {"pad": am.Box(width=40e-3, depth=40e-3, height=20e-3),
                 "plate": am.Box(width=80e-3, depth=80e-3, height=20e-3, origin=(-20e-3, -20e-3, -20e-3))}
        below, material = am.Support("plate.bottom", x=pull, y=0.0, z=0.0), am.Solid(young=2.1e11, poisson=0.3)
    return am.ContactProblem(
        name="pad", domain=am.Assembly(parts=parts), material=material, law=am.Coulomb(friction),
        contact=am.ContactPair(*pair, coupling=coupling), loads=(am.Pressure("pad.top", PRESSURE),),
        supports=(am.Support("pad.left", x=0.0), am.Support("pad.right", x=0.0), below,
                  *((am.Support("pad.front", y=0.0),) if dim == 3 else ())))


def grids(problem, dim, on_pad, on_plate):
    """Two uniform levels; cells along the edge of the pad, and of the plate over the same length."""
    def divisions(a, b):
        if dim == 2:
            return {"pad": (a, max(a // 2, 1)), "plate": (2 * b, max(b // 2, 1))}
        return {"pad": (a, a, max(a // 2, 1)), "plate": (2 * b, 2 * b, max(b // 2, 1))}

    return am.Hierarchy.uniform(problem, [divisions(on_pad // 2, on_plate // 2), divisions(on_pad, on_plate)])


@pytest.mark.parametrize("solver", [am.FullMultigrid(rtol=1e-11), EXACT], ids=["nested", "active set"])
@pytest.mark.parametrize(("dim", "slave", "coupling", "on_pad", "on_plate"), [
    (2, "pad", "mortar", 8, 5), (2, "pad", "mortar", 5, 8), (2, "plate", "mortar", 4, 4), (2, "plate", "mortar", 8, 5),
    (2, "pad", "nodes", 8, 8), (3, "pad", "mortar", 6, 4), (3, "plate", "mortar", 4, 5), (3, "pad", "nodes", 4, 4)])
def test_all_of_the_pad_slides(dim, slave, coupling, on_pad, on_plate, solver):
    problem = pad(dim, slave, coupling)
    result = am.solve(grids(problem, dim, on_pad, on_plate), solver)
    area = 40e-3 if dim == 2 else 1.6e-3
    on_the_pad, on_the_plate = result.resultant("pad.bottom").force, result.resultant("plate.top").force
    assert np.abs(on_the_pad + on_the_plate).max() <= 1e-12 * PRESSURE * area
    assert on_the_pad[-1] == pytest.approx(PRESSURE * area, rel=1e-9)
    assert (result.contact.state == am.SLIP).all()
    np.testing.assert_allclose(np.linalg.norm(result.contact.force_t, axis=1), result.contact.limit, rtol=1e-8)
    # in 3D the slip deviates by the bulge of the pad, a 1e-4 th of the pull
    assert np.abs(on_the_pad[0]) == pytest.approx(FRICTION * PRESSURE * area, rel=1e-9 if dim == 2 else 3e-7)
    # the supports of the pad take the friction
    taken = sum(result.resultant(name).force[0] for name in ("pad.left", "pad.right"))
    assert taken == pytest.approx(-on_the_pad[0], rel=1e-8)


@pytest.mark.parametrize("pull", [1e-6, 1e-3])
@pytest.mark.parametrize(("on_pad", "on_plate"), [(8, 5), (6, 9)])
def test_solvers_agree_on_a_pad(pull, on_pad, on_plate):
    levels = grids(pad(2, pull=pull), 2, on_pad, on_plate)
    assert_agrees(levels, {"nested": am.FullMultigrid(rtol=1e-11), "sparse": am.ActiveSet(condensed=False),
                           "monotone": am.FullMultigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400)})


@pytest.mark.parametrize("pull", [1e-6, 1e-3])
def test_solvers_agree_on_a_pad_in_3d(pull):
    levels = grids(pad(3, pull=pull), 3, 4, 5)
    assert_agrees(levels, {"nested": am.FullMultigrid(rtol=1e-11), "active set": EXACT})


def test_some_of_it_sticks_under_a_small_pull():
    result = am.solve(grids(pad(2, pull=1e-6), 2, 16, 16), EXACT)
    states = set(result.contact.state.tolist())
    assert am.STICK in states
    assert_balanced(result, Parts.of(pad(2, pull=1e-6), result.mesh), 1e-7)
    assert np.abs(result.contact.slip[result.contact.state == am.STICK]).max() <= 1e-15


def test_a_history_of_the_pad():
    """Pulled, pushed back, and left: friction at the held corners follows, as in solves of the single steps."""
    levels = grids(pad(2), 2, 8, 5)
    path = am.LoadPath({"plate.bottom": [1.0, -1.0]}, default=1.0)
    forth, back = am.solve_path(levels, path, am.FullMultigrid(rtol=1e-11))
    size = FRICTION * PRESSURE * 40e-3
    assert forth.resultant("pad.bottom").force[0] == pytest.approx(size, rel=1e-9)
    assert back.resultant("pad.bottom").force[0] == pytest.approx(-size, rel=1e-9)


class TestObstacle:
    """In front of a rigid plane the support says how far a held node slides."""

    @pytest.mark.parametrize("solver", [am.FullMultigrid(rtol=1e-10), EXACT], ids=["multigrid", "active set"])
    def test_all_of_a_driven_pad_slides(self, solver):
        problem = am.ContactProblem(
            domain=am.Rectangle(width=40e-3, height=20e-3), material=am.PlaneStrain(young=2.1e11, poisson=0.3),
            contact=am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1))), law=am.Coulomb(FRICTION),
            loads=(am.Pressure("top", PRESSURE),), supports=(am.Support("left", x=PULL), am.Support("right", x=PULL)))
        result = am.solve(am.Hierarchy.uniform(problem, ((4, 2), (8, 4), (16, 8))), solver)
        force = result.resultant("contact").force
        assert force[0] == pytest.approx(-FRICTION * force[1], rel=1e-9)
        assert (result.contact.state == am.SLIP).all()
        held = sum(result.resultant(name).force[0] for name in ("left", "right"))
        assert held == pytest.approx(-force[0], rel=1e-8)

    @pytest.mark.parametrize("law", [am.Coulomb(0.4), am.Tresca(1.5e7)], ids=["coulomb", "tresca"])
    @pytest.mark.parametrize("pull", [1e-7, 2e-5])
    def test_friction_is_opposite_to_all_of_the_slip(self, law, pull):
        """3D: one tangent is driven by the support, the other one free; single grids, Newton, cycles agree."""
        problem = am.ContactProblem(
            domain=am.Box(width=40e-3, depth=40e-3, height=30e-3), material=am.Solid(young=1.3e11, poisson=0.2),
            contact=am.Contact("bottom", am.Plane(point=(0, 0, 0), normal=(0, 0, 1))), law=law,
            loads=(am.Pressure("top", 5e7), am.Traction("back", (0, 5e6, 0))),
            supports=(am.Support("left", x=pull), am.Support("right", x=pull)))
        levels = am.Hierarchy.uniform(problem, ((2, 2, 2), (4, 4, 3)))
        exact = am.solve(levels, EXACT)
        contact, slides = exact.contact, exact.contact.state == am.SLIP
        against = np.sum(contact.force_t * contact.slip, axis=1)[slides]
        size = (np.linalg.norm(contact.slip, axis=1) * contact.limit)[slides]
        np.testing.assert_allclose(against, -size, rtol=1e-9)
        for solver in (am.ActiveSet(condensed=False, rtol=1e-12), am.FullMultigrid(rtol=1e-10),
                       am.Multigrid(rtol=1e-10), am.SingleGrid(condensed=True, rtol=1e-10)):
            result = am.solve(levels, solver, reference=exact)
            assert result.history["true_error"][-1] <= 3e-10

def test_a_user_is_told_where_no_node_can_take_the_place():
    problem = pad(3)
    mesh = grids(problem, 3, 6, 4).finest.mesh
    discrete = discretise(problem, mesh)
    # those whose slip the plate cannot tell apart carry no multiplier; the others do
    assert len(discrete.contact) < len(np.unique(mesh.boundary_facets("pad.bottom")))
