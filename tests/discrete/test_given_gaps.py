"""Gaps that a pair gives in place of the computed ones: closed all along when the bodies have come so much closer."""

import numpy as np
import pytest

import adaptmg as am

GAP = 1e-3


def wide_slave(dim):
    """A block above a slave that is wider on both sides, so that edges of the slave are covered in part."""
    if dim == 2:
        parts = {"upper": am.Rectangle(width=1.0, height=0.5), "lower": am.Rectangle(width=1.5, height=0.5,
                                                                                   origin=(-0.23, -0.5))}
        material, held, down = am.PlaneStrain(young=1e9, poisson=0.3), {"x": 0.0, "y": 0.0}, {"x": 0.0}
    else:
        parts = {"upper": am.Box(width=1.0, depth=1.0, height=0.5),
                 "lower": am.Box(width=1.5, depth=1.5, height=0.5, origin=(-0.23, -0.31, -0.5))}
        material, held, down = am.Solid(young=1e9, poisson=0.3), {"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0}
    down["xyz"[dim - 1]] = -1.01 * GAP
    return am.ContactProblem(domain=am.Assembly(parts=parts), material={name: material for name in parts},
                             contact=am.ContactPair("lower.top", "upper.bottom", gap=GAP), law=am.Frictionless(),
                             supports=(am.Support("lower.bottom", **held), am.Support("upper.top", **down)))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_uniform_gap_closes_everywhere_at_once(dim):
    n = 8 if dim == 2 else 5
    grids = am.Hierarchy.uniform(wide_slave(dim), [{"upper": (n,) * dim, "lower": (n + 3,) * dim}])
    mesh, discrete = grids.finest.mesh, grids.finest.discrete
    upper = np.unique(mesh.elements[mesh.element_body == mesh.bodies.index("upper")])
    moved = np.zeros(mesh.points.shape)
    moved[upper, dim - 1] = -GAP
    relative = discrete.at_contact(discrete.relative(moved).reshape(-1))
    closes = np.einsum("nd,nd->n", relative, discrete.contact.normals)
    # some rows take slave nodes along that carry no multiplier, and move more than the master
    assert closes.max() > 1.01 * GAP
    np.testing.assert_allclose(discrete.contact.gaps, closes, rtol=1e-9)
