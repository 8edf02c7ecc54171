"""Hierarchies that grow and shrink are those that would have been made at once, and nothing is made twice."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import adaptmg as am
from adaptmg import level as meshed_levels
from adaptmg.mesh import structured

SIZES = (3, 4, 6, 9, 14)


def same(a: am.Hierarchy, b: am.Hierarchy) -> bool:
    """Bit for bit."""
    def equal(x, y) -> bool:
        if x is None or y is None:
            return x is y
        return x.shape == y.shape and (x != y).nnz == 0 and np.array_equal(x.data, y.data)

    return len(a) == len(b) and all(
        equal(p.matrix, q.matrix) and equal(*(getattr(one, "prolongation", None) for one in (p, q)))
        and equal(p.surface_prolongation, q.surface_prolongation) and np.array_equal(p.discrete.load, q.discrete.load)
        for p, q in zip(a.levels, b.levels, strict=True))


@pytest.fixture(scope="module")
def bar():
    problem = am.cases.greco_bar()
    return problem, [structured(problem.domain, n) for n in SIZES]


@pytest.fixture(scope="module")
def pair():
    problem = am.cases.dovetail()
    return problem, [am.mesh.graded(problem.domain, size) for size in (10e-3, 6e-3, 4e-3)]


@pytest.mark.parametrize("which", ["bar", "pair"])
@pytest.mark.parametrize("transfer", [None, am.PseudoL2()])
def test_append_equals_from_meshes(which, transfer, request):
    problem, meshes = request.getfixturevalue(which)
    grown = am.Hierarchy.from_meshes(problem, meshes[:1], transfer)
    for mesh in meshes[1:]:
        grown = grown.append(mesh)
    assert same(grown, am.Hierarchy.from_meshes(problem, meshes, transfer))


@settings(max_examples=15, deadline=None)
@given(st.sets(st.integers(0, len(SIZES) - 2)))
@example({0})
def test_without_equals_from_the_meshes_that_are_left(bar, dropped):
    problem, meshes = bar
    rest = am.Hierarchy.from_meshes(problem, meshes)
    for level in sorted(dropped, reverse=True):
        rest = rest.without(level)
    assert same(rest, am.Hierarchy.from_meshes(problem, [m for k, m in enumerate(meshes) if k not in dropped]))


def test_contact_rows_are_remembered(bar):
    problem, meshes = bar
    plain = am.Hierarchy.from_meshes(problem, meshes[:2], am.PseudoL2(), contact_rows=False)
    assert same(plain.append(meshes[2]), am.Hierarchy.from_meshes(problem, meshes[:3], am.PseudoL2(),
                                                                  contact_rows=False))
    assert not same(plain.append(meshes[2]), am.Hierarchy.from_meshes(problem, meshes[:3], am.PseudoL2()))


def test_nothing_is_discretised_or_located_twice(bar, monkeypatch):
    problem, meshes = bar
    grids = am.Hierarchy.from_meshes(problem, meshes[:3])
    made, joins = [], []
    # a sound mesh is not checked again
    monkeypatch.setattr("adaptmg.mesh.soundness._check_closed", lambda *a: pytest.fail("checked again"))
    monkeypatch.setattr("adaptmg.hierarchy.level_of", lambda *a: made.append(a) or meshed_levels.level_of(*a))
    monkeypatch.setattr("adaptmg.hierarchy.joined", lambda *a: joins.append(a) or meshed_levels.joined(*a))
    grown = grids.append(meshes[3])
    assert (len(made), len(joins)) == (1, 1)
    assert all(a is b for a, b in zip(grown.levels, grids.levels, strict=False))
    less = grown.without(1)
    assert (len(made), len(joins)) == (1, 2)
    assert less[0] is grids[0] and less[2] is grown[3] and less[1].discrete is grids[2].discrete
    assert len(grids) == 3  # what there was stays
    assert all(grown.timings[name] >= grids.timings[name] for name in grids.timings)
    assert repr(grown.append(meshes[4])).count("grown") == 1


def test_what_cannot_grow_says_why(bar):
    problem, meshes = bar
    grids = am.Hierarchy.from_meshes(problem, meshes[:2])
    aggregated = am.Hierarchy.algebraic(am.discretise(problem, meshes[-1]), max_coarse=20)
    for call, error, message in (
            (lambda: grids.append(meshes[0]), ValueError, "coarse to fine"),
            (lambda: grids.without(1), ValueError, "level"),
            (lambda: grids.without(-1), ValueError, "level"), (lambda: grids.append(3), TypeError, "mesh"),
            (lambda: am.Hierarchy.single(grids.finest.discrete).append(meshes[2]), ValueError, "from_meshes"),
            (lambda: aggregated.append(meshes[-1]), ValueError, "from_meshes")):
        with pytest.raises(error, match=message):
            call()


def test_small_elements_far_from_the_origin_stay_nested():
    """At a corner where elements have 1e-7 of the size of the body, midpoints of edges lie off them by rounding."""
    a = 0.0193
    shape = am.Polygon(vertices=((0, 0), (a, 0), (a, a / 2), (2 * a, a / 2), (2 * a, 1.5 * a), (0, 1.5 * a)),
                       boundaries=("foot", "side", "ledge", "flank", "top", "symmetry"))
    problem = am.ContactProblem(
        name="corner", domain=shape, material=am.PlaneStrain(young=5e10, poisson=0.2), law=am.Coulomb(0.3),
        contact=am.Contact("foot", am.Plane((0, 0), (0, 1))), supports=(am.Support("symmetry", x=0.0),),
        loads=(am.Pressure("top", 1e6),))
    hierarchy = am.Hierarchy.graded(problem, (a / 1.5,))
    for _ in range(22):
        mesh = hierarchy.finest.mesh
        here = np.linalg.norm(mesh.points - [a, 0], axis=1) < 1e-12
        every = am.Estimate(squares=np.ones(len(mesh.elements)), norm=1.0)
        hierarchy = hierarchy.append(am.Bisect().refine(problem, mesh, every, here[mesh.elements].any(axis=1)))
    assert hierarchy.finest.mesh.element_sizes.min() < 3e-7 * a
    assert all(level.prolongation.data.min() > 0.49 for level in hierarchy.levels[1:])
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-6))
    assert not result.certificate().contradictions(1e-6)
