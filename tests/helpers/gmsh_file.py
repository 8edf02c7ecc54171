"""Meshes written as Gmsh writes them."""

import meshio
import numpy as np


def write(path, mesh, *, version="gmsh22", groups=True, keep=slice(None), lift=0.0, binary=False):
    """Write a mesh with a stray point in front and elements turned; groups named or not, and of
    some boundaries."""
    points, dim = np.zeros((mesh.n_nodes + 1, 3)), mesh.dim
    points[1:, :dim] = mesh.points
    points[:, 2] += lift
    names = {2: ("triangle", "line"), 3: ("tetra", "triangle")}[dim]
    cells = [(names[0], mesh.elements[:, [1, 0, *range(2, dim + 1)]] + 1)]
    physical, entity = [100 + mesh.element_body], [1 + mesh.element_body]
    for i, name in list(enumerate(mesh.boundaries))[keep]:
        cells.append((names[1], mesh.boundary_facets(name) + 1))
        physical.append(np.full(len(cells[-1][1]), 10 + i))
        entity.append(np.full(len(cells[-1][1]), 1 + i))
    field = {name: np.array([100 + k, dim]) for k, name in enumerate(mesh.bodies)}
    field |= {name: np.array([10 + i, dim - 1]) for i, name in enumerate(mesh.boundaries)}
    # MSH 4.1 finds the groups through the entities its nodes lie on: every entity must have one
    tags = np.full((len(points), 2), [dim, 1])
    for block, number in zip(cells[1:], entity[1:], strict=True):
        tags[np.unique(block[1])] = [dim - 1, number[0]]
    data = {
        "gmsh:physical": physical if groups else [0 * p for p in physical],
        "gmsh:geometrical": entity,
    }
    out = meshio.Mesh(
        points,
        cells,
        cell_data=data,
        field_data=field if groups else {},
        point_data={"gmsh:dim_tags": tags} if version == "gmsh" else {},
    )
    meshio.write(path, out, file_format=version, binary=binary)
    return path
