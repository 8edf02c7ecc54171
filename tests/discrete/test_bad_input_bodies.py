"""Bad input with several bodies: the message names the body, the pair or the boundary, and says what to do."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT, bar_on_block, in_the_corner
from refused import refused

import adaptmg as am
from adaptmg.discrete.discretise import contact_data, discretise
from adaptmg.mesh import graded, merged, structured

BAR = am.PlaneStrain(young=1.3e11, poisson=0.2)
PAIR = ("upper.bottom", "lower.top")


def posed(**changes):
    return replace(bar_on_block(am.Frictionless()), **changes)


def mesh_of(lift=0.0, bodies=("upper", "lower")):
    """The bar ``lift`` above the block."""
    parts = {name: structured(posed().domain.parts[name], 4) for name in ("upper", "lower")}
    upper = parts["upper"]
    parts["upper"] = replace(upper, points=upper.points + np.array([0.0, lift]), source=None)
    parts["other"] = parts["upper"]
    return merged({name: parts[name] for name in bodies})


BOXES = {"upper": am.Box(width=1.0, depth=1.0, height=1.0, origin=(0.0, 0.0, 0.99)),
         "lower": am.Box(width=1.0, depth=1.0, height=1.0)}


def in_3d(*pair, **options):
    problem = posed(material=am.Solid(young=1e11, poisson=0.3), contact=am.ContactPair(*pair, **options), loads=(),
                    domain=am.Assembly(parts=BOXES), supports=(am.Support("lower.bottom", x=0.0, y=0.0, z=0.0),))
    return discretise(problem, structured(problem.domain, {"upper": 2, "lower": 3}))


def faced(*pair, **options):
    return discretise(posed(contact=am.ContactPair(*pair, **options), supports=(am.Support("lower.left", x=0.0),)),
                      mesh_of(2e-3))


def circle():
    """Corners that follow each other."""
    mesh, problem, _ = in_the_corner(("floor", "wall", "cap"), am.Frictionless())
    pairs = (am.ContactPair("block.bottom", "seat.floor"), am.ContactPair("seat.wall", "block.left"),
             am.ContactPair("cap.bottom", "block.top"))
    return discretise(replace(problem, contact=pairs, supports=(am.Support("seat.bottom", x=0.0, y=0.0),)), mesh)


def nodes_that_do_not_match():
    problem = posed(contact=am.ContactPair(*PAIR, coupling="nodes"))
    return discretise(problem, structured(problem.domain, {"upper": 4, "lower": 5}))


def held(*supports, mesh=None, **changes):
    return am.solve(discretise(posed(supports=supports, **changes), mesh_of() if mesh is None else mesh))


def with_gap(gap):
    return discretise(posed(contact=am.ContactPair(*PAIR, gap=gap)), mesh_of())


def against(boundary):
    return discretise(posed(supports=(am.Support(boundary, y=0.0), am.Support("lower.bottom", y=0.0))), mesh_of())


THREE = ("upper", "lower", "other")
AXIAL = am.Axisymmetric(young=1e11, poisson=0.3)
NAMED = r"'upper.bottom' on 'lower.top'"


test_refusals = refused(
    # places
    (lambda: discretise(posed(domain=None), mesh_of(-1e-3)), NAMED + r".*overlap by up to 0.001 m.*at \(.*apart"),
    (lambda: faced("upper.bottom", "lower.bottom"), "'upper.bottom' on 'lower.bottom': the surfaces never face"),
    (lambda: faced("upper.left", "lower.top"), "'upper.left' on 'lower.top': the surfaces never face"),
    (lambda: faced(*PAIR, reach=1e-3), NAMED + ": the surfaces never face"),
    (lambda: in_3d(*PAIR), NAMED + ": the bodies overlap by up to 0.01 m"),
    (lambda: in_3d("upper.top", "lower.bottom", reach=0.5), "'upper.top' on 'lower.bottom': the surfaces never face"),
    (nodes_that_do_not_match, NAMED + ": slave node .* has no partner.*mortar"),
    # gaps
    (lambda: with_gap(lambda x: x[:, 0] - 0.02), NAMED + ".*the bodies overlap by up to 0.02 m.*allow_interference"),
    (lambda: with_gap(lambda x: x), NAMED + r".*must return shape \(5,\)"),
    (lambda: with_gap(lambda x: np.nan * x[:, 0]), NAMED + ".*must be finite, got nan"),
    # what holds bodies
    (lambda: discretise(posed(material=BAR, domain=None), mesh_of(bodies=THREE)),
     r"nothing holds body 'other': no support and no contact"),
    (lambda: am.solve(discretise(posed(loads=(am.Traction("upper.top", (0.0, 1e6)),)), mesh_of())),
     r"nothing holds.*translation along y of body 'upper'"),
    (lambda: held(am.Support("lower.bottom", x=0.0, y=0.0), loads=(am.Pressure("upper.top", 1e6),)),
     r"not unique.*translation along x of body 'upper'"),
    (lambda: held(am.Support("upper.top", x=0.0, y=0.0)), "body 'lower'"),
    (lambda: against("upper.bottom"), r"'upper.bottom' fixes y.*'upper.bottom'.*common node"),
    (lambda: against("upper.left"), r"'upper.left' fixes y.*'upper.bottom'.*common node"),
    # pairs
    (circle, r"follow each other in a circle.*exchange slave and master"),
    # names
    (lambda: discretise(posed(domain=None, contact=am.ContactPair("uper.bottom", "lower.top")), mesh_of()),
     r"'uper.bottom', used for contact.*did you mean 'upper.bottom'\?"),
    (lambda: am.Hierarchy.uniform(posed(), [{"upper": 2, "lowr": 2}, 4]),
     r"divisions must name each body once.*'upper', 'lowr'"),
    (lambda: discretise(posed(domain=None), mesh_of(bodies=THREE)),
     r"bodies are 'upper', 'lower', 'other', material names 'upper', 'lower'"),
    (lambda: posed(material=AXIAL), r"x = -0.02 m, but x is the radius"))


def test_gaps_and_interference():
    assert discretise(posed(domain=None), mesh_of(1e-3)).contact.gaps == pytest.approx(1e-3)
    # with the flag what overlaps is pressed apart
    problem = posed(domain=None, contact=am.ContactPair(*PAIR, allow_interference=True))
    result = am.solve(discretise(problem, mesh_of(-1e-5)), EXACT)
    assert result.contact.gap.min() >= 0
    for name in ("nothing", ""):
        with pytest.raises(ValueError, match=f"'{name}' is not known; known are 'contact'"):
            result.resultant(name)


@pytest.mark.parametrize("pair", [("round.contact", "block.top"), ("block.top", "round.contact")])
@pytest.mark.parametrize("at_the_end", [True, False], ids=["pole at the end of the surface", "pole within a facet"])
def test_a_cylinder_that_touches_a_block_does_not_overlap_it(at_the_end, pair):
    """The mean of a distance >= 0 with a dual function, which changes sign, may be negative; that is not an overlap."""
    radius, size, left = 0.05, 0.01, 0.0 if at_the_end else -0.1
    for sunk in (0.0, 4e-3):
        centre = (0.0, radius - sunk)
        angles = np.radians([0.0, 45.0, 90.0] if at_the_end else [-90.0, -40.0, 40.0, 90.0])
        arc = [(radius * np.sin(a), centre[1] - radius * np.cos(a)) for a in angles]
        names = ("contact", "side", "top", "axis") if at_the_end else ("side", "contact", "side", "top")
        cylinder = am.Outline(vertices=[*arc, centre] if at_the_end else arc, boundaries=names,
                              arcs={i: centre for i in range(len(arc) - 1)})
        domain = am.Assembly(parts={"round": cylinder, "block": am.Rectangle(width=0.1 - left, height=radius,
                                                                           origin=(left, -radius))})
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3), domain=domain, law=am.Frictionless(),
            contact=am.ContactPair(*pair), supports=(am.Support("round.axis" if at_the_end else "round.top", x=0.0),
                                                     am.Support("block.bottom", x=0.0, y=0.0)))
        mesh = graded(domain, {"round": size, "block": 1.7 * size}, pair)
        if not sunk:
            assert contact_data(problem, mesh)[0].gaps.min() >= 0
            continue
        with pytest.raises(ValueError, match="overlap by up to"):
            contact_data(problem, mesh)
