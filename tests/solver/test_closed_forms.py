"""Matrix and load against closed forms: the second opinion of the certificate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am


def turned(angle, points):
    cosine, sine = np.cos(angle), np.sin(angle)
    return [tuple(p) for p in np.asarray(points) @ np.array([[cosine, sine], [-sine, cosine]])]


def problem(seed, elements="linear"):
    """A turned, shifted, scaled quadrilateral on springs, under a pressure and its weight."""
    rng = np.random.default_rng(seed)
    scale = 10 ** rng.uniform(-3, 1)
    corners = np.array([(0, 0), (1, 0.1), (1.1, 0.8), (-0.1, 1)]) * scale
    vertices = turned(rng.uniform(0, 6), corners + rng.uniform(-2, 2, 2) * scale)
    return am.ContactProblem(
        domain=am.Polygon(vertices=vertices, boundaries=("foot", "right", "top", "left")),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        elements=elements,
        law=am.Coulomb(0.3),
        contact=am.Contact("right", am.GapFunction(lambda x: np.full(len(x), 1e-5 * scale))),
        supports=[am.Spring("foot", normal=1e9 / scale, tangential=3e8 / scale)],
        loads=[
            am.Pressure("top", 1e5),
            am.BodyForce((1e3, -2e4)),
            am.PointForce(vertices[2], (30.0, -50.0)),
        ],
    )


def grids(seed, elements="linear"):
    posed = problem(seed, elements)
    size = np.ptp(np.array(posed.domain.vertices), axis=0).max() / 4
    return am.Hierarchy.graded(posed, (size, size / 2), contact_ratio=2)


@pytest.mark.parametrize("elements", ["linear", "smoothed"])
def test_what_is_right_passes(elements):
    for seed in range(4):
        certificate = am.solve(grids(seed, elements)).certificate()
        assert certificate["stiffness"].relative < 1e-12
        assert certificate["loads"].relative < 1e-12
    pair = am.Hierarchy.graded(am.cases.two_block_patch())
    assert am.solve(pair).certificate()["stiffness"].relative < 1e-11


def damaged(hierarchy, matrix=None, load=None):
    """The hierarchy with another finest matrix or load."""
    discrete = hierarchy.finest.discrete
    parts = {"matrix": matrix, "load": load}
    wrong = discrete.posing(**{name: value for name, value in parts.items() if value is not None})
    finest = hierarchy.finest.posing(discrete=wrong)
    return replace(hierarchy, levels=(*hierarchy.levels[:-1], finest))


def test_a_spring_at_another_place_contradicts_however_loose_the_tolerance():
    hierarchy = grids(1)
    discrete = hierarchy.finest.discrete
    held = hierarchy.finest.mesh.boundary_nodes("foot")
    stiffness = sparse.lil_array(discrete.matrix)
    node, other = 2 * held[0], 2 * hierarchy.finest.mesh.boundary_nodes("top")[1]
    lost = 0.01 * stiffness[node, node]
    stiffness[node, node] -= lost
    stiffness[other, other] += lost
    wrong = sparse.bsr_array(sparse.csr_array(stiffness), blocksize=(2, 2))
    for solver in (am.ActiveSet(), am.FullMultigrid(rtol=0.1)):
        result = am.solve(damaged(hierarchy, matrix=wrong), solver, throw=False)
        assert not result.status.ok
        assert "stiffness" in result.certificate().contradictions(0.1)


def test_a_load_of_another_moment_contradicts():
    hierarchy = grids(2)
    load = hierarchy.finest.discrete.load.copy()
    top = hierarchy.finest.mesh.boundary_nodes("top")
    change = 1e-3 * np.abs(load).max()
    load[2 * top[0]] += change  # the same force
    load[2 * top[-1]] -= change
    result = am.solve(damaged(hierarchy, load=load), am.ActiveSet(), throw=False)
    assert not result.status.ok
    assert result.certificate().contradictions(1e-3) == ("loads",)
