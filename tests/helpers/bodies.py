"""Bodies in contact: stacks with exact states, the bar on a block, bodies in a corner."""

from dataclasses import replace

import numpy as np
import pytest
from saddle import Parts, held_alike
from scipy.spatial.transform import Rotation

import adaptmg as am

EXACT = am.ActiveSet(rtol=1e-12)
SOFT, STIFF = am.PlaneStrain(young=7e10, poisson=0.34), am.PlaneStrain(young=2.1e11, poisson=0.28)
#: of the lower and the upper body
MATERIALS = {2: (STIFF, SOFT), 3: (am.Solid(**vars(STIFF)), am.Solid(**vars(SOFT)))}
P = 5e7


def rotation(turn):
    """The matrix of an angle in the plane, or of a rotation vector."""
    if np.ndim(turn):
        return Rotation.from_rotvec(turn).as_matrix()
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]])


def random_turn(rng, dim=3):
    """The matrix of a random rotation."""
    turn = np.linalg.qr(rng.standard_normal((dim, dim)))[0]
    turn[0] *= np.linalg.det(turn)
    return turn


def slabs(dim, **low):
    """Blocks that are 0.5 high, by the heights of their bottoms."""
    box, depth = (am.Box, {"depth": 1.0}) if dim == 3 else (am.Rectangle, {})
    return {
        name: box(width=1.0, height=0.5, origin=(*[0.0] * (dim - 1), bottom), **depth)
        for name, bottom in low.items()
    }


def turned(mesh, turn):
    """A mesh turned about the origin."""
    return am.MeshArrays(
        mesh.points @ rotation(turn).T,
        mesh.elements,
        mesh.facets,
        mesh.facet_labels,
        mesh.boundaries,
        element_body=mesh.element_body,
        bodies=mesh.bodies,
    )


def dragged_block(dim, floor):
    """A block that 1e7 Pa press on a plane, or on a wider floor that is the slave, with friction 0.3;
    the support "drag" moves its top by 1e-4 m. Slave nodes next to the ends of the block take over
    the part of their neighbours."""
    body = am.Box(width=0.04, depth=0.03, height=0.02)
    if dim == 2:
        body = am.Rectangle(width=0.04, height=0.02)
    top = "top"
    contact = am.Contact("bottom", am.Plane(np.zeros(dim), np.eye(dim)[-1]))
    supports = []
    if floor:
        lower = am.Rectangle(width=0.1, height=0.02, origin=(-0.033, -0.02))
        body = am.Assembly(parts={"block": body, "floor": lower})
        top = "block.top"
        contact = am.ContactPair("floor.top", "block.bottom")
        supports = [am.Support("floor.bottom", x=0.0, y=0.0)]
    drag = am.Support(top, x=1e-4, y=0.0 if dim == 3 else None, name="drag")
    return am.ContactProblem(
        domain=body,
        material=MATERIALS[dim][0],
        law=am.Coulomb(0.3),
        contact=contact,
        loads=am.Pressure(top, 1e7),
        supports=[drag, *supports],
    )


def held_at_points(problem, mesh, exact, points, load=0.0):
    """The discrete problem with prescribed values of ``exact`` (n_nodes, dim) at some (node,
    component)."""
    parts = Parts.of(problem, mesh)
    fixed, values = np.zeros(mesh.points.shape, dtype=bool), np.zeros(mesh.points.shape)
    for node, component in points:
        fixed[node, component] = True
        values[node, component] = exact[node, component]
    return am.DiscreteProblem(
        matrix=parts.matrix,
        load=parts.load + np.ravel(load),
        fixed=fixed.ravel(),
        fixed_values=values.ravel(),
        law=parts.law,
        contact=parts.contact,
        coordinates=mesh.points,
        near_nullspace=am.discrete.rigid_motions(mesh),
    ).coupled(parts.weights)


def far_node(mesh, body, direction):
    """The node of a body farthest in a direction."""
    nodes = np.unique(mesh.elements[mesh.element_body == mesh.bodies.index(body)])
    return nodes[np.argmax(mesh.points[nodes] @ np.asarray(direction))]


def assert_state(result, exact, pressure=P):
    np.testing.assert_allclose(result.displacement, exact, atol=1e-10 * np.abs(exact).max())
    np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-9)
    assert np.abs(result.contact.traction).max() < 1e-9 * pressure


def stacked(divisions, width=1.0):
    """A mesh of blocks "lower", "middle" (with three divisions), "upper", all 1 wide but the
    last."""
    names = ("lower", "upper") if len(divisions) == 2 else ("lower", "middle", "upper")
    parts = {
        name: am.Rectangle(
            width=width if name == "upper" else 1.0, height=0.6, origin=(0.0, 0.6 * k)
        )
        if len(divisions[0]) == 2
        else am.Box(width=1.0, depth=1.0, height=0.6, origin=(0.0, 0.0, 0.6 * k))
        for k, name in enumerate(names)
    }
    return am.mesh.merged(
        {name: am.mesh.structured(parts[name], n) for name, n in zip(names, divisions, strict=True)}
    )


def uniaxial(mesh, materials):
    """Exact displacement of a stack under the pressure P, zero at the origin."""
    exact, base = np.zeros(mesh.points.shape), 0.0
    for k, material in enumerate(materials):
        nodes, nu = np.unique(mesh.elements[mesh.element_body == k]), material.poisson
        plane = isinstance(material, am.PlaneStrain)
        axial = -P / material.young * (1 - nu**2 if plane else 1)
        exact[nodes] = -axial * nu / (1 - nu if plane else 1) * mesh.points[nodes]
        exact[nodes, -1] = base + axial * (mesh.points[nodes, -1] - 0.6 * k)
        base += 0.6 * axial
    return exact


def pressed(mesh, pairs, materials, law=None):
    """A stack under the pressure P with rollers below, at the left, and in front."""
    dim, sides = mesh.dim, {"left": "x", "front": "y"}
    return am.ContactProblem(
        material=dict(zip(mesh.bodies, materials, strict=True)),
        contact=tuple(am.ContactPair(*p) for p in pairs),
        law=am.Frictionless() if law is None else law,
        loads=(am.Pressure("upper.top", P),),
        supports=(
            am.Support("lower.bottom", **{"xyz"[dim - 1]: 0.0}),
            *(
                am.Support(f"{body}.{side}", **{sides[side]: 0.0})
                for side in list(sides)[: dim - 1]
                for body in mesh.bodies
            ),
        ),
    )


UPPER_ON_LOWER, LOWER_ON_UPPER = ("upper.bottom", "lower.top"), ("lower.top", "upper.bottom")
PAIRS = pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
DIMS = pytest.mark.parametrize("dim", [2, 3])
CORNER = {
    "seat": am.Polygon(
        vertices=[(-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)],
        boundaries=("bottom", "right", "floor", "wall", "top", "left"),
    ),
    "block": am.Rectangle(width=1.0, height=1.0),
    "cap": am.Rectangle(width=1.0, height=0.5, origin=(0.0, 1.0)),
}


def in_the_corner(order, law):
    """A block in the corner of a seat, a cap on the block, equal pressure all around: mesh,
    problem, exact state."""
    mesh = am.mesh.merged(
        {
            "seat": am.mesh.graded(CORNER["seat"], 0.3, ()),
            "block": am.mesh.structured(CORNER["block"], (4, 5)),
            "cap": am.mesh.structured(CORNER["cap"], (3, 2)),
        }
    )
    pairs = {
        "floor": am.ContactPair("block.bottom", "seat.floor"),
        "wall": am.ContactPair("block.left", "seat.wall"),
        "cap": am.ContactPair("cap.bottom", "block.top"),
    }
    outside = (
        "seat.bottom",
        "seat.right",
        "seat.top",
        "seat.left",
        "block.right",
        "cap.top",
        "cap.left",
        "cap.right",
    )
    problem = am.ContactProblem(
        material=SOFT,
        contact=tuple(pairs[name] for name in order),
        law=law,
        loads=tuple(am.Pressure(name, P) for name in outside),
    )
    strain = (1 + SOFT.poisson) * (1 - 2 * SOFT.poisson) * P / SOFT.young
    return mesh, problem, -strain * mesh.points


def bar_on_block(law, pair=UPPER_ON_LOWER, **options):
    """The GRECO bar pressed on an elastic block 1.5 times as wide."""
    size, bar = 40e-3, am.PlaneStrain(young=1.3e11, poisson=0.2)
    return am.ContactProblem(
        material={"upper": bar, "lower": bar},
        law=law,
        domain=am.Assembly(
            parts={
                "upper": am.Rectangle(width=size, height=size),
                "lower": am.Rectangle(width=1.5 * size, height=size, origin=(-0.5 * size, -size)),
            }
        ),
        contact=am.ContactPair(*pair, **options),
        loads=(am.Pressure("upper.top", 5e7), am.Pressure("upper.left", 15e7)),
        supports=(
            am.Support("upper.right", x=0.0),
            am.Support("lower.right", x=0.0),
            am.Support("lower.bottom", y=0.0),
        ),
    )


def bumpy(points):
    return 4e-6 * (1 + np.sin(points[:, 0] * 400))


def corner_pushed(law):
    """Three bodies, three pairs, unequal loads; the cap follows the block, which follows the
    seat."""
    _, problem, _ = in_the_corner(("wall", "floor", "cap"), law)
    loads = (
        am.Pressure("cap.top", lambda x: 4e7 * (1 + x[:, 0])),
        am.Pressure("block.right", 3e7),
        am.Traction("cap.left", (4e6, 0.0)),
    )
    return replace(
        problem,
        domain=am.Assembly(parts=CORNER),
        loads=loads,
        supports=(am.Support("seat.bottom", x=0.0, y=0.0), am.Support("cap.right", x=0.0)),
    )


def bar_hierarchy(problem, n=3):
    return am.Hierarchy.uniform(
        problem, [{"upper": k, "lower": (5 * k // 4, k)} for k in (4, 8, 16, 32)[:n]]
    )


def assert_agrees(grids, solvers):
    """All find one displacement that meets the conditions of contact; forces balance on the
    untransformed system."""
    parts, first = Parts.of(grids.problem, grids.finest.mesh), None
    nodes = parts.contact.nodes
    for name, solver in solvers.items():
        result = am.solve(grids, solver)
        contact, u = result.contact, result.displacement
        first = u if first is None else first
        size = first.ravel() @ (parts.matrix @ first.ravel())
        assert (u - first).ravel() @ (parts.matrix @ (u - first).ravel()) <= 1e-16 * size, name
        assert not result.certificate().contradictions(1e-8), name
        # relative to the master, but along what supports fix on both sides
        relative = u[nodes] - np.where(held_alike(parts), 0.0, parts.weights[nodes] @ u)
        # means where a node takes over a part of its neighbour
        relative = relative * (contact.weights / contact.measures)[:, None]
        local = np.einsum("nkd,nd->nk", contact.frames, relative)
        np.testing.assert_allclose(
            np.column_stack([contact.u_n, contact.u_t]), local, atol=1e-8 * np.abs(u).max()
        )
        assert_balanced(result, parts, 1e-7)


def assert_balanced(result, parts, tolerance, flat=True):
    """Slaves and masters to rounding; supports and loads, and free nodes, to the tolerance of the
    solver."""
    contact, mesh = result.contact, result.mesh
    load = parts.load.reshape(-1, mesh.dim)
    size, arm = np.abs(load).sum(), np.ptp(mesh.points)
    for slave, master in zip(contact.names, contact.masters, strict=True):
        if master:
            one, other = result.resultant(slave), result.resultant(master)
            assert np.abs(one.force + other.force).max() <= 1e-12 * size
            # surfaces that lie on each other: no lever between the forces
            assert not flat or np.abs(one.moment + other.moment).max() <= 1e-12 * size * arm
    of_contact = np.zeros_like(load)
    of_contact[contact.node] = contact.force
    np.add.at(of_contact, contact.master_node, contact.master_force)
    supports = np.where(parts.fixed.reshape(load.shape), result.reaction - of_contact, 0.0)
    assert (
        np.abs(result.reaction - of_contact - supports).max()
        <= tolerance * np.abs(of_contact).max()
    )
    # around an axis of symmetry radial forces balance by themselves
    assert (
        np.abs((supports + load + of_contact).sum(axis=0))[int(parts.axisymmetric) :].max()
        <= tolerance * size
    )
    # each force at the nodes of a boundary with a support belongs to one boundary, or is shared
    named = [
        result.resultant(name).force
        for name in mesh.boundaries
        if name not in (*contact.names, *contact.masters)
    ]
    np.testing.assert_allclose(np.sum(named, axis=0), supports.sum(axis=0), atol=tolerance * size)
