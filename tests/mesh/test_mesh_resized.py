"""Meshes by sizes at points: sizes are followed, domains met, the same arguments give the same arrays."""

import math

import numpy as np
import pytest

import adaptmg as am
import adaptmg.mesh.resized as resized_module
from adaptmg.mesh import check_mesh, quality
from adaptmg.mesh.resized import PointSizes, resized

PLATE = am.Rectangle(width=0.46, height=0.25, origin=(0.6, 0.2))
# a quarter of a ring: two arcs
RING = am.Outline(vertices=((1, 0), (2, 0), (0, 2), (0, 1)), boundaries=("foot", "outer", "side", "inner"),
                  arcs={1: (0, 0), 3: (0, 0)})


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


@pytest.mark.parametrize("refinements", [0, 2])
@pytest.mark.parametrize("smallest", [3e-3, 3e-5])
def test_plane_sizes_are_followed(smallest, refinements):
    place, growth = PLATE.lower, 0.24 / 2**refinements
    mesh = resized(PLATE, sizes_near(PLATE, place, smallest, growth, 60), refinements=refinements)
    check_mesh(mesh, PLATE.boundaries)
    relative = np.sqrt(mesh.volumes * 4 / math.sqrt(3)) / field(
        mesh.points[mesh.elements].mean(axis=1), place, smallest, growth)
    assert 0.85 < np.median(relative) < 1.15
    assert np.quantile(relative, 0.01) > 0.6 and np.quantile(relative, 0.99) < 1.45
    assert quality(mesh).min_angle > 20
    assert mesh.volumes.sum() == pytest.approx(0.46 * 0.25, rel=1e-13)
    assert (mesh.points[mesh.boundary_nodes("right"), 0] == PLATE.upper[0]).all()
    assert mesh.boundaries == PLATE.boundaries


def test_nodes_lie_on_arcs():
    mesh = check_mesh(resized(RING, sizes_near(RING, (2, 0), 0.01, 0.1, 50), refinements=1), RING.boundaries)
    for name, radius in (("outer", 2), ("inner", 1)):
        nodes = mesh.boundary_nodes(name)
        assert len(nodes) > 10
        np.testing.assert_allclose(np.linalg.norm(mesh.points[nodes], axis=1), radius, rtol=1e-14)
    assert quality(mesh).min_angle > 20


def test_bodies_have_their_own_sizes():
    left, right = am.Rectangle(width=1, height=1), am.Rectangle(width=1, height=1, origin=(1, 0))
    both = am.Assembly(parts={"left": left, "right": right})
    uniform = {"left": PointSizes(left.lower[None], [0.5]), "right": PointSizes(right.lower[None], [0.1])}
    mesh = check_mesh(resized(both, uniform))
    assert mesh.bodies == ("left", "right") and "right.top" in mesh.boundaries
    nodes = [len(np.unique(mesh.elements[mesh.element_body == k])) for k in range(2)]
    assert nodes[0] < 20 and nodes[1] > 100
    with pytest.raises(ValueError, match="sizes must name each body once"):
        resized(both, {"left": uniform["left"]})


def test_where_netgen_fails_it_is_asked_again(monkeypatch):
    make, asked, failures = resized_module._plane_or_box, [], 3

    def failing(domain, sizes, grading, refinements):
        asked.append(refinements)
        if len(asked) <= failures:
            raise ValueError("a face failed")
        return make(domain, sizes, grading, refinements)

    monkeypatch.setattr(resized_module, "_plane_or_box", failing)
    sizes = PointSizes(PLATE.lower[None], [0.1])
    check_mesh(resized(PLATE, sizes, refinements=2), PLATE.boundaries)
    assert asked == [2, 2, 0, 0]
    failures = 99
    with pytest.raises(ValueError, match=r"could not mesh Rectangle.*a face failed.*start from a finer mesh"):
        resized(PLATE, sizes, refinements=2)
