"""Gmsh files of several bodies: glued where they share nodes, or split so that each has nodes of its own."""

import numpy as np
import pytest

from adaptmg.mesh import check_mesh, from_gmsh
from adaptmg.mesh.arrays import element_facets

# two cubes of six tetrahedra each, stacked along z, conforming at z = 1
CUBE = [(0, 1, 3, 7), (0, 1, 7, 5), (0, 5, 7, 4), (0, 3, 2, 7), (0, 6, 4, 7), (0, 2, 6, 7)]


def cube_nodes(low):
    return [(x, y, z) for z in (low, low + 1) for y in (0, 1) for x in (0, 1)]


def stacked(shared):
    """Points, tetrahedra with their body (1, 2), triangles with their surface."""
    points = cube_nodes(0) + cube_nodes(1)
    numbers = [list(range(8)), list(range(8, 16))]
    if shared:
        points, numbers[1] = points[:8] + points[12:], [*range(4, 8), *range(8, 12)]
    tetrahedra = [(1 + k, [own[i] for i in cell]) for k, own in enumerate(numbers) for cell in CUBE]
    triangles, seen = [], set()
    for body, cell in tetrahedra:
        cell = np.array(cell)
        corners = np.array(points)[cell]
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            cell = cell[[0, 1, 3, 2]]
        for facet in element_facets(cell[None])[0]:
            z = {points[i][2] for i in facet}
            key = tuple(sorted(facet.tolist()))
            flat = [d for d in range(2) if len({points[i][d] for i in facet}) == 1]
            if key in seen or not (len(z) == 1 or flat):
                continue
            seen.add(key)
            surface = {0: 11, 1: 12, 2: 13}[z.pop()] if len(z) == 1 else 14
            triangles.append((surface, facet.tolist(), body))
    return points, tetrahedra, triangles


def write(path, shared, *, skip=(), names=("lower", "upper")):
    """MSH 2.2 as text."""
    points, tetrahedra, triangles = stacked(shared)
    triangles = [t for t in triangles if t[0] not in skip]
    groups = [(3, 1, names[0]), (3, 2, names[1]), (2, 11, "base"), (2, 12, "interface"), (2, 13, "lid"),
              (2, 14, "wall")]
    cells = [(2, group, nodes) for group, nodes, _ in triangles] + [(4, group, nodes) for group, nodes in tetrahedra]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    lines += [f'{dim} {number} "{name}"' for dim, number, name in groups]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    lines += [f"{i + 1} {x} {y} {z}" for i, (x, y, z) in enumerate(points)]
    lines += ["$EndNodes", "$Elements", str(len(cells))]
    lines += [f"{i + 1} {kind} 2 {group} {group} " + " ".join(str(n + 1) for n in nodes)
              for i, (kind, group, nodes) in enumerate(cells)]
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    return path


def test_bodies_are_glued_by_default(tmp_path):
    mesh = from_gmsh(write(tmp_path / "m.msh", shared=True))
    assert mesh.n_nodes == 12 and mesh.bodies == ("lower", "upper")
    # the interface lies inside
    assert mesh.boundaries == ("base", "lid", "wall")
    np.testing.assert_allclose(np.bincount(mesh.element_body, mesh.volumes), 1)


@pytest.mark.parametrize("shared", [True, False])
def test_split_bodies_share_no_nodes(tmp_path, shared):
    mesh = check_mesh(from_gmsh(write(tmp_path / "m.msh", shared), split_bodies=True))
    assert mesh.n_nodes == 16 and mesh.bodies == ("lower", "upper") and mesh.source.nv == 16
    assert mesh.boundaries == ("lower.base", "lower.interface", "lower.wall",
                               "upper.interface", "upper.lid", "upper.wall")
    np.testing.assert_allclose(np.bincount(mesh.element_body, mesh.volumes), 1)
    for body, name, z, up in ((0, "lower.interface", 1, 1), (1, "upper.interface", 1, -1), (0, "lower.base", 0, -1),
                              (1, "upper.lid", 2, 1)):
        facets = mesh.boundary_facets(name)
        assert len(facets) == 2 and (mesh.points[facets][..., 2] == z).all()
        a, b, c = np.moveaxis(mesh.points[facets], 1, 0)
        np.testing.assert_allclose(0.5 * np.cross(b - a, c - a).sum(axis=0), (0, 0, up))
        assert set(facets.ravel()) <= set(mesh.elements[mesh.element_body == body].ravel())
    assert len(mesh.boundary_facets("lower.wall")) == len(mesh.boundary_facets("upper.wall")) == 8
    # body by body
    assert (np.diff(mesh.element_body) >= 0).all()
    assert mesh.elements[mesh.element_body == 0].max() < mesh.elements[mesh.element_body == 1].min()


def test_bodies_that_share_no_nodes_need_no_splitting(tmp_path):
    mesh = from_gmsh(write(tmp_path / "m.msh", shared=False))
    assert mesh.n_nodes == 16 and mesh.boundaries == ("base", "interface", "lid", "wall")
    assert len(mesh.boundary_facets("interface")) == 4


def test_an_interface_without_a_name(tmp_path):
    path = write(tmp_path / "m.msh", shared=True, skip=(12,))
    assert from_gmsh(path).boundaries == ("base", "lid", "wall")
    with pytest.raises(ValueError, match=r"4 facets of the boundary, one of them at \(.*belong to no physical group"):
        from_gmsh(path, split_bodies=True)
    mesh = from_gmsh(path, split_bodies=True, unnamed="joint")
    assert set(mesh.boundaries) == {"lower.base", "lower.wall", "lower.joint", "upper.lid", "upper.wall", "upper.joint"}
    for name in ("lower.joint", "upper.joint"):
        assert len(mesh.boundary_facets(name)) == 2 and (mesh.points[mesh.boundary_nodes(name), 2] == 1).all()


def test_a_dot_in_the_name_of_a_body(tmp_path):
    path = write(tmp_path / "m.msh", shared=True, names=("a.1", "a.2"))
    assert from_gmsh(path).bodies == ("a.1", "a.2")
    # it would be read as body.boundary
    split = from_gmsh(path, split_bodies=True)
    assert split.bodies == ("a_1", "a_2") and "a_1.interface" in split.boundaries
