"""Numbers of nodes whose products leave 32 bits: a problem behind 47 000 nodes of another body is
the problem alone."""

from dataclasses import replace

import numpy as np
import pytest
from behind import mesh_behind, problem_behind
from bodies import random_turn, slabs

import adaptmg as am

SOLVER = am.ActiveSet(rtol=1e-10)
CUBE = am.Box(width=1, depth=1, height=1)
SPRUNG = am.Spring("lower.bottom", normal=2e11, tangential=1e11)


def pressed(dim, seed, elements="linear"):
    """Springs, a tie, a pair, a crack along it in 2D and a moving obstacle, turned at random."""
    rng = np.random.default_rng(seed)
    turn = random_turn(rng, dim)
    parts = slabs(dim, upper=1.0, middle=0.5, lower=0.0)
    mesh = am.mesh.structured(am.Assembly(parts=parts), {"upper": 3, "middle": 4, "lower": 6})
    contact = [am.ContactPair("upper.bottom", "middle.top")]
    if dim == 2:
        at = [[0.25, 0.25], [0.5, 0.25], [0.75, 0.25]]
        mesh = am.mesh.structured(am.Assembly(parts=parts), {"upper": 3, "middle": 4, "lower": 4})
        row = [int(np.argmin(np.linalg.norm(mesh.points - x, axis=1))) for x in at]
        mesh = am.mesh.split(mesh, np.column_stack([row[:-1], row[1:]]))
        contact.append(am.ContactPair("crack.left", "crack.right"))
    mesh = replace(mesh, points=mesh.points @ turn.T + rng.normal(size=dim))
    top = mesh.surface("upper.top")
    wall = am.Plane(top.points[top.facets[0, 0]], -turn[:, -1])
    down = tuple(-1e-4 * turn[:, -1] + 1e-5 * turn[:, 0])
    problem = am.ContactProblem(
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=2e11, poisson=0.3),
        law=am.Coulomb(0.3),
        elements=elements,
        contact=[*contact, am.Contact("upper.top", am.Moving(wall, displacement=down))],
        ties=am.Tied("middle.bottom", "lower.top"),
        loads=am.Pressure("middle.left", 1e7),
        supports=(SPRUNG, am.Spring("upper.right", normal=1e10, tangential=1e10)),
    )
    return problem, mesh


def guided():
    """A block that turned planes press, and push along an obstacle with which they share edges."""
    turn = random_turn(np.random.default_rng(3))
    mesh = am.mesh.structured(CUBE, 5)
    shifts = {"left": -1e-3, "right": 4e-4, "front": 2e-4, "top": -2e-3}
    problem = am.ContactProblem(
        material=am.Solid(young=1e7, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0, 0.0), turn[:, -1])),
        supports=[am.Support(name, normal=shift) for name, shift in shifts.items()],
    )
    return problem, replace(mesh, points=mesh.points @ turn.T)


def periodic():
    """A cell whose mean shear is prescribed, on springs."""
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 6)
    return am.ContactProblem(
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        ties=am.Periodic("left", "right", jump=(0, 1e-3)),
        loads=am.Pressure("top", 1e7),
        supports=am.Spring("bottom", normal=2e11, tangential=1e11),
    ), replace(mesh)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the bodies span")
@pytest.mark.parametrize(
    "posed",
    [
        lambda: pressed(2, 1),
        lambda: pressed(2, 2, "smoothed"),
        lambda: pressed(3, 3),
        guided,
        periodic,
    ],
    ids=["plane", "smoothed", "solid", "guided", "periodic"],
)
def test_a_problem_behind_many_nodes_is_the_problem_alone(posed):
    problem, mesh = posed()
    alone = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), SOLVER)
    whole, n = mesh_behind(mesh)
    result = am.solve(am.Hierarchy.from_meshes(problem_behind(problem, whole), [whole]), SOLVER)
    size = np.abs(alone.displacement).max()
    np.testing.assert_allclose(result.displacement[n:], alone.displacement, atol=1e-9 * size)
    np.testing.assert_array_equal(result.contact.node, alone.contact.node + n)
    np.testing.assert_array_equal(result.contact.state, alone.contact.state)
    force = np.abs(alone.reaction).max()
    np.testing.assert_allclose(result.reaction[n:], alone.reaction, atol=1e-9 * force)


@pytest.mark.parametrize(("dim", "n"), [(2, 60), (3, 10)])
def test_slits_behind_many_nodes_open_as_alone(dim, n):
    """Every second layer is cut: the corners of elements at slits times the nodes leave 32 bits."""
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1) if dim == 2 else CUBE, n)
    layer = n * mesh.points[:, -1]
    inside = (np.abs(mesh.points - 0.5) < 0.49).all(axis=1) & (np.round(layer) % 2 == 0)
    ends = mesh.elements[:, [np.delete(np.arange(dim + 1), k) for k in range(dim + 1)]]
    flat = np.ptp(layer[ends], axis=2) < 0.5
    facets = ends[flat & inside[ends].all(axis=2)]
    facets = facets[np.unique(np.sort(facets, axis=1), axis=0, return_index=True)[1]]
    whole, first = mesh_behind(mesh, 150_000)
    alone, behind = am.mesh.split(mesh, facets), am.mesh.split(whole, facets + first)
    np.testing.assert_array_equal(behind.elements[behind.element_body > 0] - first, alone.elements)
    np.testing.assert_array_equal(behind.points[first:], alone.points)
