"""What is posed of each node of a boundary: the same rows however the bodies are turned, shifted and
numbered, and behind many other nodes."""

from dataclasses import replace

import numpy as np
import pytest
from behind import FAR, mesh_behind, problem_behind
from bodies import rotation
from simplex_meshes import disk, numbered_at_random

import adaptmg as am
from adaptmg.discrete.posed import Posed, Role

HELD, MASTER, OBSTACLE, SLAVE, TIED = Role
DOWN = (0, -1)
LEFT = (-1, 0)
# of the stack below: body, place, role, owner, normal, gap, weight, and what is taken over
ROWS = [
    ("pad", (0, 1), SLAVE, 1, DOWN, 0, 0.25, 0),
    ("pad", (0.5, 1), SLAVE, 1, DOWN, 0, 0.5, 0.5),  # half an edge of the node on the roller
    ("pad", (1, 1), HELD, -1, (0, 0), 0, 0, 0),  # the table does not follow the roller
    ("pad", (0, 1.5), OBSTACLE, 2, LEFT, 0, 0.5, 0.5),  # half an edge of the pad's corner
    ("pad", (0, 2), OBSTACLE, 2, LEFT, 0, 0.25, 0),
    *(("pad", (1, y), HELD, -1, (0, 0), 0, 0, 0) for y in (1.5, 2)),
    ("table", (0, 0), OBSTACLE, 0, LEFT, 0.25, 0.25, 0),
    ("table", (0, 0.5), OBSTACLE, 0, LEFT, 0.25, 0.5, 0),
    ("table", (0, 1), OBSTACLE, 0, LEFT, 0.25, 0.25, 0),
    *(("table", (x, y), MASTER, -1, (0, 0), 0, 0, 0) for x in (0.5, 1, 1.5, 2) for y in (0, 1)),
    # half an edge each of the clamped node and of the tied one, with their gaps
    ("foot", (0, -0.5), OBSTACLE, 3, LEFT, 0.25 + 2 * 0.5 * 0.25, 0.5, 1.0),
    *(("foot", (x, 0), TIED, 0, (0, 0), 0, 0.25, 0) for x in (0, 2)),
    *(("foot", (x, 0), TIED, 0, (0, 0), 0, 0.5, 0) for x in (0.5, 1, 1.5)),
    *(("foot", (x, -1), HELD, -1, (0, 0), 0, 0, 0) for x in (0, 0.5, 1, 1.5, 2)),
]


def stack(turn, shift):
    """A pad (1 x 1) on a table (2 x 1) on a foot that is tied to it and moved, both with a wall on
    the left; the pad's left side touches a wall, its right side is on a roller."""
    parts = {
        "pad": am.Rectangle(width=1, height=1, origin=(0, 1)),
        "table": am.Rectangle(width=2, height=1),
        "foot": am.Rectangle(width=2, height=1, origin=(0, -1)),
    }
    mesh = am.mesh.structured(am.Assembly(parts=parts), {"pad": 2, "table": (4, 2), "foot": (4, 2)})
    walls = [am.Plane(turn @ at + shift, turn[:, 0]) for at in ((-0.25, 0), (0, 0))]
    problem = am.ContactProblem(
        material=dict.fromkeys(parts, am.PlaneStrain(young=1e9, poisson=0.3)),
        law=am.Coulomb(0.3),
        contact=(
            am.Contact("table.left", walls[0]),
            am.ContactPair("pad.bottom", "table.top"),
            am.Contact("pad.left", walls[1]),
            am.Contact("foot.left", walls[0]),
        ),
        ties=am.Tied("foot.top", "table.bottom"),
        supports=(
            am.Support("foot.bottom", **dict(zip("xy", 1e-3 * turn[:, 0], strict=True))),
            am.Support("pad.right", normal=2e-3),
        ),
    )
    return problem, replace(mesh, points=mesh.points @ turn.T + shift)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize(("angle", "shift"), [(0.0, (0, 0)), (np.pi / 2, (3, -7)), (0.7, (-5, 2))])
def test_rows_of_a_stack_turn_with_it(angle, shift, far):
    turn = rotation(angle)
    problem, mesh = stack(turn, np.array(shift))
    mesh = numbered_at_random(mesh, 1)
    if far:
        problem = problem_behind(problem, mesh)
        mesh, _ = mesh_behind(mesh)
    posed = Posed.of(problem, mesh)
    rows = posed.rows
    straight = (mesh.points - shift) @ turn
    at = np.array(
        [
            next(n for n in posed.bodies[body] if np.allclose(straight[n], where, atol=1e-9))
            for body, where, *_ in ROWS
        ]
    )
    near = np.flatnonzero(~np.isin(rows.nodes, posed.bodies[FAR])) if far else slice(None)
    np.testing.assert_array_equal(rows.nodes[near], np.sort(at))
    mine = np.searchsorted(rows.nodes, at)
    _, _, role, owner, normal, gap, weight, taken = map(list, zip(*ROWS, strict=True))
    np.testing.assert_array_equal(rows.role[mine], role)
    np.testing.assert_array_equal(rows.owner[mine], owner)
    np.testing.assert_allclose(rows.normals[mine] @ turn, normal, atol=1e-12)
    np.testing.assert_allclose(rows.gaps[mine], gap, atol=1e-12)
    np.testing.assert_allclose(rows.weights[mine], weight, atol=1e-12)
    np.testing.assert_allclose(rows.taken_over.sum(axis=1)[mine], taken, atol=1e-12)
    # what supports hold, and whither they move it
    vectors = np.tile([[1.0, 2.0]] @ turn.T, (len(at), 1))
    free = posed.free_part(at, vectors) @ turn
    clamped = np.array([y == -1 for _, (_, y), *_ in ROWS])
    rolling = np.array([body == "pad" and x == 1 for body, (x, _), *_ in ROWS])
    np.testing.assert_allclose(free[:, 0], np.where(clamped | rolling, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(free[:, 1], np.where(clamped, 0.0, 2.0), atol=1e-12)
    moved = {hold.support.boundary: hold.values for hold in posed.holds}
    assert set(moved["pad.right"]) == {2e-3} and set(posed.directions) >= {"pad.right"}
    # the slaves and tied nodes follow what lies opposite, and whom they take over from
    facing = at[[k for k, one in enumerate(ROWS) if one[2] in (SLAVE, TIED)]]
    np.testing.assert_allclose(rows.follows[facing] @ straight, straight[facing], atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_rows_of_a_disc_turn_with_it(seed):
    rng = np.random.default_rng(seed)
    mesh = disk(3)
    size = 10.0 ** rng.uniform(-3, 1)
    shift = rng.uniform(-5, 5, 2)
    turn = rotation(rng.uniform(0, 6))
    mesh = numbered_at_random(replace(mesh, points=size * mesh.points @ turn.T + shift), seed)
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        contact=am.Contact("all", am.GapFunction(lambda x: 0.1 + 0.02 * (x - shift)[:, 0] / size)),
        law=am.Frictionless(),
    )
    rows = Posed.of(problem, mesh).rows
    out = (mesh.points[rows.nodes] - shift) / size
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0)
    assert len(rows.nodes) == 18 and (rows.role == OBSTACLE).all() and not rows.owner.any()
    np.testing.assert_allclose(rows.normals, out, atol=1e-12)
    np.testing.assert_allclose(rows.gaps, 0.1 + 0.02 * out[:, 0])
    np.testing.assert_allclose(rows.weights, 2 * size * np.sin(np.pi / 18))
    assert rows.taken_over is None and rows.follows is None
