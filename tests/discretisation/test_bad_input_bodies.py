"""Bad input with several bodies: the message names the body, the pair or the boundary, and says what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT, SOFT, bar_on_block, in_the_corner

import adaptmg as am
from adaptmg.discrete.contact import contact_data
from adaptmg.discrete.discretise import discretise
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


class TestPlacesOfBodies:
    def test_bodies_that_overlap(self):
        with pytest.raises(ValueError, match=r"'upper.bottom' on 'lower.top'.*overlap by up to 0.001 m.*at \(.*apart"):
            discretise(posed(domain=None), mesh_of(-1e-3))
        assert discretise(posed(domain=None), mesh_of(1e-3)).contact.gaps == pytest.approx(1e-3)
        # with the flag the same is pressed apart
        problem = posed(domain=None, contact=am.ContactPair(*PAIR, allow_interference=True))
        assert am.solve(discretise(problem, mesh_of(-1e-5)), EXACT).contact.gap.min() >= 0

    @pytest.mark.parametrize("pair", [am.ContactPair("upper.bottom", "lower.bottom"), am.ContactPair(
        "upper.left", "lower.top"), am.ContactPair(*PAIR, reach=1e-3)], ids=["hidden", "beside", "out of reach"])
    def test_surfaces_that_never_face_each_other(self, pair):
        problem = posed(contact=pair, supports=(am.Support("lower.left", x=0.0),))
        with pytest.raises(ValueError, match=rf"'{pair.slave}' on '{pair.master}': the surfaces never face"):
            discretise(problem, mesh_of(2e-3))

    def test_in_3d(self):
        parts = {"upper": am.Box(width=1.0, depth=1.0, height=1.0, origin=(0.0, 0.0, 0.99)),
                 "lower": am.Box(width=1.0, depth=1.0, height=1.0)}
        problem = am.ContactProblem(material=am.Solid(young=1e11, poisson=0.3), law=am.Frictionless(),
                                    domain=am.Assembly(parts=parts), contact=am.ContactPair(*PAIR),
                                    supports=(am.Support("lower.bottom", x=0.0, y=0.0, z=0.0),))
        mesh = structured(problem.domain, {"upper": 2, "lower": 3})
        with pytest.raises(ValueError, match=r"'upper.bottom' on 'lower.top': the bodies overlap by up to 0.01 m"):
            discretise(problem, mesh)
        with pytest.raises(ValueError, match=r"'upper.top' on 'lower.bottom': the surfaces never face"):
            discretise(replace(problem, contact=am.ContactPair("upper.top", "lower.bottom", reach=0.5)), mesh)

    def test_meshes_that_do_not_match(self):
        problem = posed(contact=am.ContactPair(*PAIR, coupling="nodes"))
        with pytest.raises(ValueError, match=r"'upper.bottom' on 'lower.top': slave node .* has no partner.*mortar"):
            discretise(problem, structured(problem.domain, {"upper": 4, "lower": 5}))


class TestGaps:
    @pytest.mark.parametrize(("gap", "message"), [
        (lambda x: x[:, 0] - 0.02, "the bodies overlap by up to 0.02 m.*allow_interference=True"),
        (lambda x: x, r"must return shape \(5,\)"), (lambda x: np.nan * x[:, 0], "must be finite, got nan")])
    def test_functions(self, gap, message):
        problem = posed(contact=am.ContactPair(*PAIR, gap=gap))
        with pytest.raises(ValueError, match=rf"contact pair 'upper.bottom' on 'lower.top'.*{message}"):
            discretise(problem, mesh_of())

    def test_negative_numbers(self):
        with pytest.raises(ValueError, match=r"gap must be >= 0, got -1e-06; .*allow_interference=True"):
            am.ContactPair(*PAIR, gap=-1e-6)
        with pytest.raises(ValueError, match=r"clearance must be >= 0, got -1e-05: .*allow_interference=True"):
            am.cases.dovetail(clearance=-1e-5)


class TestWhatHoldsBodies:
    def test_a_body_that_nothing_touches(self):
        with pytest.raises(ValueError, match=r"nothing holds body 'other': no support and no contact"):
            discretise(posed(material=BAR, domain=None), mesh_of(bodies=("upper", "lower", "other")))

    def test_free_bodies(self):
        discrete = discretise(posed(loads=(am.Traction("upper.top", (0.0, 1e6)),)), mesh_of())
        with pytest.raises(ValueError, match=r"nothing holds.*translation along y of body 'upper'"):
            am.solve(discrete)
        problem = posed(supports=(am.Support("lower.bottom", x=0.0, y=0.0),), loads=(am.Pressure("upper.top", 1e6),))
        with pytest.raises(ValueError, match=r"not unique.*translation along x of body 'upper'"):
            am.solve(discretise(problem, mesh_of()))
        problem = posed(supports=(am.Support("upper.top", x=0.0, y=0.0),))
        with pytest.raises(ValueError, match=r"body 'lower'"):
            am.solve(discretise(problem, mesh_of()))

    @pytest.mark.parametrize("boundary", ["upper.bottom", "upper.left"])
    def test_a_support_against_the_contact(self, boundary):
        problem = posed(supports=(am.Support(boundary, y=0.0), am.Support("lower.bottom", y=0.0)))
        with pytest.raises(ValueError, match=rf"'{boundary}' fixes y.*'upper.bottom'.*common node"):
            discretise(problem, mesh_of())


class TestPairs:
    def test_a_slave_named_twice(self):
        pairs = (am.ContactPair(*PAIR), am.ContactPair("upper.bottom", "lower.left"))
        with pytest.raises(ValueError, match=r"'upper.bottom' is named twice"):
            posed(contact=pairs)
        with pytest.raises(ValueError, match=r"'lower.top' is the master of 'upper.bottom' and slave of another"):
            posed(contact=(pairs[0], am.ContactPair("lower.top", "upper.left")))

    def test_a_surface_on_itself(self):
        with pytest.raises(ValueError, match=r"slave and master are both 'upper.bottom': name two different"):
            am.ContactPair("upper.bottom", "upper.bottom")

    def test_corners_that_follow_each_other(self):
        mesh, problem, _ = in_the_corner(("floor", "wall", "cap"), am.Frictionless())
        pairs = (am.ContactPair("block.bottom", "seat.floor"), am.ContactPair("seat.wall", "block.left"),
                 am.ContactPair("cap.bottom", "block.top"))
        problem = replace(problem, contact=pairs, supports=(am.Support("seat.bottom", x=0.0, y=0.0),))
        with pytest.raises(ValueError, match=r"follow each other in a circle.*exchange slave and master"):
            discretise(problem, mesh)


class TestNames:
    def test_boundaries(self):
        with pytest.raises(ValueError, match=r"'lower.topp', used for contact.*did you mean 'lower.top'\?.*upper.top"):
            posed(contact=am.ContactPair("upper.bottom", "lower.topp"))
        with pytest.raises(ValueError, match=r"'lower.botom', used for a support.*did you mean 'lower.bottom'\?"):
            posed(supports=(am.Support("lower.botom", y=0.0),))
        with pytest.raises(ValueError, match=r"'uper.bottom', used for contact.*did you mean 'upper.bottom'\?"):
            discretise(posed(domain=None, contact=am.ContactPair("uper.bottom", "lower.top")), mesh_of())
        with pytest.raises(ValueError, match=r"'wall', used for a load, does not exist; the boundaries are"):
            posed(loads=(am.Pressure("wall", 1.0),))

    def test_bodies(self):
        with pytest.raises(ValueError, match=r"body 'uper', used for a load, .*did you mean 'upper'\?"):
            posed(loads=(am.BodyForce((0.0, -1.0), body="uper"),))
        with pytest.raises(ValueError, match=r"the bodies are 'upper', 'lower', material names 'uper', 'lower'"):
            posed(material={"uper": BAR, "lower": SOFT})
        with pytest.raises(ValueError, match=r"divisions must name each body once.*'upper', 'lowr'"):
            am.Hierarchy.uniform(posed(), [{"upper": 2, "lowr": 2}, 4])
        with pytest.raises(ValueError, match=r"bodies are 'upper', 'lower', 'other', material names 'upper', 'lower'"):
            discretise(posed(domain=None), mesh_of(bodies=("upper", "lower", "other")))

    def test_kinds_of_materials(self):
        axial = am.Axisymmetric(young=1e11, poisson=0.3)
        with pytest.raises(ValueError, match=r"'upper': 'Axisymmetric', 'lower': 'PlaneStrain'"):
            posed(material={"upper": axial, "lower": BAR})
        with pytest.raises(ValueError, match=r"x = -0.02 m, but x is the radius"):
            posed(material=axial)

    def test_resultants(self):
        result = am.solve(discretise(posed(), mesh_of()), EXACT)
        for name in ("nothing", ""):
            with pytest.raises(ValueError, match=f"'{name}' is not known; known are 'contact'"):
                result.resultant(name)


@pytest.mark.parametrize("slave_is_round", [True, False])
@pytest.mark.parametrize("kind", ["pole at the end of the surface", "pole within a facet"])
def test_a_cylinder_that_touches_a_block_does_not_overlap_it(kind, slave_is_round):
    """The mean of a distance >= 0 with a dual function, which changes sign, may be negative; that is not an overlap."""
    radius, size = 0.05, 0.01
    for sunk in (0.0, 4e-3):
        centre = (0.0, radius - sunk)
        angles = np.radians([0.0, 45.0, 90.0] if "end" in kind else [-90.0, -40.0, 40.0, 90.0])
        arc = [(radius * np.sin(a), centre[1] - radius * np.cos(a)) for a in angles]
        names = ("contact", "side", "top", "axis") if "end" in kind else ("side", "contact", "side", "top")
        cylinder = am.Outline(vertices=[*arc, centre] if "end" in kind else arc, boundaries=names,
                              arcs={i: centre for i in range(len(arc) - 1)})
        left = 0.0 if "end" in kind else -2 * radius
        domain = am.Assembly(parts={"round": cylinder, "block": am.Rectangle(
            width=2 * radius - left, height=radius, origin=(left, -radius))})
        pair = ("round.contact", "block.top") if slave_is_round else ("block.top", "round.contact")
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3), domain=domain, law=am.Frictionless(),
            contact=am.ContactPair(*pair), loads=(am.Pressure("round.top", 1e5),),
            supports=(am.Support("round.axis" if "end" in kind else "round.top", x=0.0),
                      am.Support("block.bottom", x=0.0, y=0.0)))
        mesh = graded(domain, {"round": size, "block": 1.7 * size}, pair)
        if not sunk:
            assert contact_data(problem, mesh)[0].gaps.min() >= 0
            continue
        with pytest.raises(ValueError, match="overlap by up to"):
            contact_data(problem, mesh)[0]
