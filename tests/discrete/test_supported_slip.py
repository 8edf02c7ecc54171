"""Friction at contact nodes of which a support holds a tangential component: a pad held at its sides, a block."""

import numpy as np
import pytest
from bodies import assert_agrees, assert_balanced
from saddle import Parts

import adaptmg as am

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


@pytest.mark.parametrize(("dim", "slave", "coupling", "on_pad", "on_plate"), [
    (2, "pad", "mortar", 8, 5), (2, "pad", "mortar", 5, 8), (2, "plate", "mortar", 4, 4), (2, "plate", "mortar", 8, 5),
    (2, "pad", "nodes", 8, 8), (3, "pad", "mortar", 6, 4), (3, "plate", "mortar", 4, 5), (3, "pad", "nodes", 4, 4)])
def test_all_of_the_pad_slides(dim, slave, coupling, on_pad, on_plate):
    result = am.solve(grids(pad(dim, slave, coupling), dim, on_pad, on_plate), EXACT)
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
    if (dim, slave, coupling) == (3, "pad", "mortar"):
        # nodes whose slip the plate cannot tell apart carry no multiplier
        assert len(result.contact) < len(result.mesh.boundary_nodes("pad.bottom"))


@pytest.mark.parametrize("pull", [1e-6, 1e-3])
@pytest.mark.parametrize(("dim", "on_pad", "on_plate"), [(2, 8, 5), (2, 6, 9), (3, 4, 5)])
def test_solvers_agree_on_a_pad(dim, on_pad, on_plate, pull):
    levels = grids(pad(dim, pull=pull), dim, on_pad, on_plate)
    assert_agrees(levels, {"nested": am.FullMultigrid(rtol=1e-11), "sparse": am.ActiveSet(condensed=False)} | (
        {"monotone": am.FullMultigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400)} if dim == 2 else {}))


def test_some_of_it_sticks_under_a_small_pull():
    result = am.solve(grids(pad(2, pull=1e-6), 2, 16, 16), EXACT)
    sticks = result.contact.state == am.STICK
    assert sticks.any() and np.abs(result.contact.slip[sticks]).max() <= 1e-15
    assert_balanced(result, Parts.of(pad(2, pull=1e-6), result.mesh), 1e-7)


def test_a_history_of_the_pad():
    """Pulled, pushed back, and left: friction at the held corners follows, as in solves of the single steps."""
    levels = grids(pad(2), 2, 8, 5)
    path = am.LoadPath({"plate.bottom": [1.0, -1.0]}, default=1.0)
    forth, back = am.solve_path(levels, path, am.FullMultigrid(rtol=1e-11))
    size = FRICTION * PRESSURE * 40e-3
    assert forth.resultant("pad.bottom").force[0] == pytest.approx(size, rel=1e-9)
    assert back.resultant("pad.bottom").force[0] == pytest.approx(-size, rel=1e-9)


@pytest.mark.parametrize(("law", "pull"), [(am.Coulomb(0.4), 1e-7), (am.Coulomb(0.4), 2e-5), (am.Tresca(1.5e7), 1e-7)],
                         ids=["little", "far", "tresca"])
def test_friction_is_opposite_to_all_of_the_slip(law, pull):
    """On a rigid plane: one tangent is driven by the support, the other one free; Newton and cycles agree."""
    problem = am.ContactProblem(
        domain=am.Box(width=40e-3, depth=40e-3, height=30e-3), material=am.Solid(young=1.3e11, poisson=0.2), law=law,
        contact=am.Contact("bottom", am.Plane(point=(0, 0, 0), normal=(0, 0, 1))),
        loads=(am.Pressure("top", 5e7), am.Traction("back", (0, 5e6, 0))),
        supports=(am.Support("left", x=pull), am.Support("right", x=pull)))
    levels = am.Hierarchy.uniform(problem, ((2, 2, 2), (4, 4, 3)))
    exact = am.solve(levels, EXACT)
    contact, slides = exact.contact, exact.contact.state == am.SLIP
    against = np.sum(contact.force_t * contact.slip, axis=1)[slides]
    size = (np.linalg.norm(contact.slip, axis=1) * contact.limit)[slides]
    np.testing.assert_allclose(against, -size, rtol=1e-9)
    for solver in (am.ActiveSet(condensed=False, rtol=1e-12), am.FullMultigrid(rtol=1e-10)):
        assert am.solve(levels, solver, reference=exact).history["true_error"][-1] <= 3e-10
