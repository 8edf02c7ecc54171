"""Bodies in contact: conditions and balance on the untransformed system, limits, interference fits."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import (
    DIMS,
    EXACT,
    LOWER_ON_UPPER,
    MATERIALS,
    PAIRS,
    UPPER_ON_LOWER,
    P,
    assert_agrees,
    assert_balanced,
    bar_hierarchy,
    bar_on_block,
    bumpy,
    corner_pushed,
    turned,
)
from saddle import Parts

import adaptmg as am
from adaptmg.discrete.discretise import discretise
from adaptmg.mesh import structured

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(1.5e7), "friction 0.3": am.Coulomb(0.3)}
#: that all methods agree between bodies: tests/agreement
SOLVERS = {"nested start": am.FullMultigrid(rtol=1e-11), "cold": am.Multigrid(rtol=1e-11), "active set": EXACT}


def ring_on_disk(law):
    """A ring pressed unevenly, and from inside, on a larger disk."""
    steel = am.Axisymmetric(young=2.1e11, poisson=0.3)
    return am.ContactProblem(
        material={"upper": replace(steel, young=7e10), "lower": steel}, law=law,
        domain=am.Assembly(parts={"upper": am.Rectangle(width=0.04, height=0.03, origin=(0.01, 0.0)),
                                  "lower": am.Rectangle(width=0.07, height=0.03, origin=(0.0, -0.03))}),
        contact=am.ContactPair(*UPPER_ON_LOWER),
        loads=(am.Pressure("upper.top", lambda x: 1e8 * (2 - x[:, 0] / 0.03)), am.Pressure("upper.left", 1.5e8)),
        supports=(am.Support("lower.left", x=0.0), am.Support("lower.bottom", y=0.0)))


def turned_bar(law):
    """For meshes turned by any angle: no rollers, so the supports hold all components."""
    return replace(bar_on_block(law), domain=None, supports=(am.Support("lower.bottom", x=0.0, y=0.0),),
                   loads=(am.Pressure("upper.top", lambda x: 5e7 * (1 + 5 * x[:, 0])), am.Pressure("upper.left", 5e6)))


def block_on_slab(law, pair=UPPER_ON_LOWER, **options):
    """A block pressed and pushed both ways along a wider slab, stiffer than it."""
    return am.ContactProblem(
        material=dict(zip(("lower", "upper"), MATERIALS[3], strict=True)), law=law,
        domain=am.Assembly(parts={"upper": am.Box(width=1.0, depth=1.0, height=1.0), "lower": am.Box(
            width=1.5, depth=1.25, height=0.5, origin=(0.0, 0.0, -0.5))}),
        contact=am.ContactPair(*pair, **options),
        loads=(am.Pressure("upper.top", P), am.Pressure("upper.right", 2.4 * P),
               am.Traction("upper.top", (0.0, 0.2 * P, 0.0))),
        supports=(am.Support("upper.left", x=0.0), am.Support("upper.front", y=0.0), am.Support("lower.left", x=0.0),
                  am.Support("lower.front", y=0.0), am.Support("lower.bottom", z=0.0)))


def wavy(points):
    return 1e-5 * (2 + np.sin(9 * points[:, 0]) + np.cos(7 * points[:, 1]))


def nested(problem):
    return am.Hierarchy.uniform(problem, [{"upper": 2 * k, "lower": (3 * k, 2 * k, k)} for k in (1, 2)])


PROBLEMS = {
    "block": lambda law: bar_hierarchy(bar_on_block(law, LOWER_ON_UPPER)),
    "interference": lambda law: bar_hierarchy(bar_on_block(law, gap=lambda x: bumpy(x) - 5e-6,
                                                           allow_interference=True)),
    "graded": lambda law: am.Hierarchy.graded(bar_on_block(law), sizes=(16e-3, 8e-3, 4e-3), contact_ratio=2),
    "corner": lambda law: am.Hierarchy.graded(corner_pushed(law), sizes=(0.5, 0.3, 0.17), contact_ratio=1.5),
    "axisymmetric": lambda law: am.Hierarchy.uniform(
        ring_on_disk(law), [{"upper": (4 * k, 3 * k), "lower": (5 * k, 2 * k)} for k in (1, 2, 4)]),
    "turned": lambda law: am.Hierarchy.from_meshes(turned_bar(law), [
        turned(structured(bar_on_block(law).domain, {"upper": k, "lower": k + 1}), 0.7) for k in (4, 7, 12)]),
    "upper 3D": lambda law: nested(block_on_slab(law)),
    "lower 3D": lambda law: nested(block_on_slab(law, LOWER_ON_UPPER)),
    "wavy 3D": lambda law: nested(block_on_slab(law, gap=wavy)),
    "independent 3D": lambda law: am.Hierarchy.from_meshes(replace(block_on_slab(law), domain=None), [
        structured(block_on_slab(law).domain, {"upper": k, "lower": (k + 1, k + 2, 1)}) for k in (2, 3)]),
    "node to node 3D": lambda law: am.Hierarchy.uniform(block_on_slab(law, coupling="nodes"), [
        {"upper": (2 * k, 4 * k, k), "lower": (3 * k, 5 * k, k)} for k in (1, 2)])}


@pytest.mark.parametrize(("make", "law"), [(make, "friction 0.3") for make in PROBLEMS] + [
    ("block", "frictionless"), ("corner", "frictionless"), ("lower 3D", "frictionless"), ("axisymmetric", "tresca"),
    ("turned", "tresca"), ("lower 3D", "tresca")])
def test_solvers_agree_and_forces_balance(make, law):
    assert_agrees(PROBLEMS[make](LAWS[law]), SOLVERS)


@DIMS
def test_forces_balance_however_loose_the_solver(dim):
    grids = (bar_hierarchy(bar_on_block(am.Coulomb(0.5), LOWER_ON_UPPER)) if dim == 2
             else nested(block_on_slab(am.Coulomb(0.3), LOWER_ON_UPPER, gap=wavy)))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-2))
    assert result.residual > 1e-6
    on_slave, on_master = (result.resultant(name) for name in LOWER_ON_UPPER)
    size = np.abs(on_slave.force).max()
    assert size > 1e6 and np.abs(on_slave.force + on_master.force).max() <= 1e-13 * size
    assert np.abs(on_slave.moment + on_master.moment).max() <= 1e-13 * size
    assert_balanced(result, Parts.of(grids.problem, grids.finest.mesh), 1.0)
    total = am.solve(grids, EXACT).resultant("lower.bottom").force[-1]
    assert total == pytest.approx(P * (40e-3 if dim == 2 else 1.0), rel=1e-9)


@DIMS
@PAIRS
def test_an_interference_fit(dim, pair):
    # two blocks between rigid walls, too long together: uniaxial strain, compliance (1+nu)(1-2nu)/(E(1-nu))
    overlap, heights = (2e-4 if dim == 2 else 1e-4), {"lower": 0.6, "upper": 0.4}
    shape, depth = (am.Rectangle, {}) if dim == 2 else (am.Box, {"depth": 1.0})
    parts = {body: shape(width=1.0, height=height, **depth, origin=(*[0.0] * (dim - 1), base))
             for (body, height), base in zip(heights.items(), (0.0, 0.6 - overlap), strict=True)}
    walls, up = {"left": "x", "right": "x", "front": "y", "back": "y"}, "xyz"[dim - 1]
    supports = (am.Support("lower.bottom", **{up: 0.0}), am.Support("upper.top", **{up: 0.0}), *(
        am.Support(f"{body}.{wall}", **{walls[wall]: 0.0}) for body in parts for wall in list(walls)[:2 * dim - 2]))
    materials = dict(zip(heights, MATERIALS[dim], strict=True))
    problem = am.ContactProblem(material=materials, domain=am.Assembly(parts=parts), supports=supports,
                                law=am.Coulomb(0.3), contact=am.ContactPair(*pair, allow_interference=True))
    grids = am.Hierarchy.uniform(problem, [{"lower": (k, k), "upper": (5 * k // 4, k)} for k in (4, 8)] if dim == 2
                                 else [{"lower": (2 * k, k, k), "upper": (k, 3 * k, k)} for k in (1, 2)])
    compliance = {name: (1 + m.poisson) * (1 - 2 * m.poisson) / (m.young * (1 - m.poisson))
                  for name, m in materials.items()}
    pressure = overlap / sum(heights[name] * compliance[name] for name in heights)
    for solver in (EXACT, am.FullMultigrid(rtol=1e-10), am.Multigrid(rtol=1e-10),
                   am.Multigrid(correction=am.Monotone(), rtol=1e-10), am.SingleGrid(condensed=True, rtol=1e-12)):
        result = am.solve(grids, solver)
        np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-7)
        assert np.abs(result.contact.gap).max() <= 1e-8 * overlap
        top = grids.finest.mesh.boundary_nodes("lower.top")
        np.testing.assert_allclose(result.displacement[top, -1], -pressure * 0.6 * compliance["lower"], rtol=1e-7)
    # from a start that overlaps, one that gapes, and the solution
    for start in (np.zeros_like(result.displacement), result, 3 * result.displacement):
        again = am.solve(grids, am.Multigrid(rtol=1e-10), start=start)
        np.testing.assert_allclose(again.contact.pressure, pressure, rtol=1e-7)
        assert again.cycles <= (1 if start is result else 30)
    deep = rf"{pair[0]}.*{pair[1]}.*overlap by up to {overlap:.4f} m.*allow_interference"
    with pytest.raises(ValueError, match=deep):
        discretise(replace(problem, contact=am.ContactPair(*pair)), grids.finest.mesh)


def test_a_support_on_the_master_is_no_trouble():
    down = -3e-5  # the upper body follows the master
    problem = bar_on_block(am.Frictionless())
    held = (am.Support("lower.top", x=0.0, y=down), am.Support("upper.right", x=0.0))
    rigid = am.solve(discretise(am.cases.greco_bar(law=am.Frictionless()),
                                structured(problem.domain.parts["upper"], 4)), EXACT)
    result = am.solve(am.Hierarchy.uniform(replace(problem, supports=held), [{"upper": 4, "lower": 5}]), EXACT)
    np.testing.assert_allclose(result.displacement[:25] - [0, down], rigid.displacement, atol=1e-10 * abs(down))
    # the master passes on what the support takes
    assert result.resultant("lower.top").force == pytest.approx(-result.resultant("upper.bottom").force)


@DIMS
def test_a_given_gap_closes_everywhere_at_once(dim):
    """The slave is wider than the master: rows that take other slave nodes along move more than the master."""
    gap, make = 1e-3, bar_on_block if dim == 2 else block_on_slab
    problem = make(am.Frictionless(), LOWER_ON_UPPER, gap=gap)
    mesh = structured(problem.domain, {"upper": 8, "lower": 11} if dim == 2 else {"upper": 5, "lower": 8})
    discrete, upper = discretise(problem, mesh), np.unique(mesh.elements[mesh.element_body == 0])
    moved = np.zeros(mesh.points.shape)
    moved[upper, dim - 1] = -gap
    relative = discrete.at_contact(discrete.relative(moved).reshape(-1))
    closes = np.einsum("nd,nd->n", relative, discrete.contact.normals)
    assert mesh.bodies[0] == "upper" and closes.max() > 1.01 * gap
    np.testing.assert_allclose(discrete.contact.gaps, closes, rtol=1e-9)
