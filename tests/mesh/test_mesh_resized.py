"""Meshes by sizes at points: sizes are followed, domains met, the same arguments give the same arrays."""

import math

import numpy as np
import pytest

import adaptmg as am
import adaptmg.mesh.resized as resized_module
from adaptmg.mesh import check_mesh, quality
from adaptmg.mesh.resized import PointSizes, resized

BLOCK = am.Box(width=0.46, depth=0.25, height=0.2, origin=(0.6, 0.2, 0.1))


def sizes_near(domain, place, smallest, growth, n=40):
    """Sizes that grow from a place, on a lattice over the bounding box, dense near the place."""
    axes = []
    for low, high, at in zip(domain.lower, domain.upper, place, strict=True):
        near = at + np.r_[-1, 1][:, None] * np.geomspace(0.3 * smallest, high - low, n)
        axes.append(np.unique(np.clip(np.r_[near.ravel(), np.linspace(low, high, n // 2), at], low, high)))
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(axes))
    return PointSizes(points, field(points, place, smallest, growth))


def field(x, place, smallest, growth):
    return smallest + growth * np.linalg.norm(x - np.array(place), axis=1)


@pytest.mark.parametrize("refinements", [0, 1])
def test_sizes_are_followed(refinements):
    place, growth = BLOCK.lower, 0.3 / 2**refinements
    mesh = resized(BLOCK, sizes_near(BLOCK, place, 0.01, growth, 20), refinements=refinements)
    check_mesh(mesh, BLOCK.boundaries)
    relative = np.cbrt(mesh.volumes * 6 * math.sqrt(2)) / field(mesh.points[mesh.elements].mean(axis=1), place, 0.01,
                                                                growth)
    assert 0.7 < np.median(relative) < 1.2 and np.quantile(relative, 0.99) < 1.6
    assert quality(mesh).min_angle > 8
    assert mesh.volumes.sum() == pytest.approx(0.46 * 0.25 * 0.2, rel=1e-13)
    assert (mesh.points[mesh.boundary_nodes("right"), 0] == BLOCK.upper[0]).all()
    assert mesh.boundaries == BLOCK.boundaries


def test_bodies_have_their_own_sizes():
    left, right = (am.Box(width=1, depth=1, height=1, origin=(x, 0, 0)) for x in (0, 1))
    both = am.Assembly(parts={"left": left, "right": right})
    uniform = {"left": PointSizes(left.lower[None], [0.5]), "right": PointSizes(right.lower[None], [0.2])}
    mesh = check_mesh(resized(both, uniform))
    assert mesh.bodies == ("left", "right") and "right.top" in mesh.boundaries
    nodes = [len(np.unique(mesh.elements[mesh.element_body == k])) for k in range(2)]
    assert nodes[0] < 60 and nodes[1] > 100
    with pytest.raises(ValueError, match="sizes must name each body once"):
        resized(both, {"left": uniform["left"]})


def test_where_netgen_fails_it_is_asked_again(monkeypatch):
    make, asked, failures = resized_module._box, [], 3

    def failing(domain, sizes, grading, refinements):
        asked.append(refinements)
        if len(asked) <= failures:
            raise ValueError("a face failed")
        return make(domain, sizes, grading, refinements)

    monkeypatch.setattr(resized_module, "_box", failing)
    sizes = PointSizes(BLOCK.lower[None], [0.1])
    check_mesh(resized(BLOCK, sizes, refinements=2), BLOCK.boundaries)
    assert asked == [2, 2, 0, 0]
    failures = 99
    with pytest.raises(ValueError, match=r"could not mesh Box.*a face failed.*start from a finer mesh"):
        resized(BLOCK, sizes, refinements=2)


def test_plane_domains_are_refused():
    plate = am.Rectangle(width=1, height=1)
    with pytest.raises(TypeError, match="domain must be a Box, another solid"):
        resized(plate, PointSizes(plate.lower[None], [0.1]))
