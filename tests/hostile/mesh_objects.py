"""Meshes as objects: arrays, ngsolve meshes and masks that are wrong."""

from dataclasses import replace

import netgen.meshing
import ngsolve
import numpy as np
from hostile_table import Hostile, each, labelled

import adaptmg as am

SQUARE = am.mesh.structured(am.Rectangle(width=1, height=1), 3)
CUBE = am.mesh.structured(am.Box(width=1, depth=1, height=1), 2)
NAN = float("nan")

# array, place, value of another type or size
VALUES = {
    "node n": ("elements", (2, 0), 10**4),
    "node -1": ("elements", (2, 0), -1),
    "node 2**63": ("elements", (2, 0), np.uint64(2**63)),
    "facet node -7": ("facets", (1, 0), -7),
    "label 99": ("facet_labels", 1, 99),
    "label .5": ("facet_labels", 1, 0.5),
    "body 5": ("element_body", 1, 5),
    "nan": ("points", (0, 0), NAN),
}
TYPES = {
    "nodes as floats": ("elements", float),
    "nodes as objects": ("elements", object),
    "complex points": ("points", complex),
}


def _set(mesh: am.MeshArrays, name: str, where, value) -> am.MeshArrays:
    array = getattr(mesh, name).astype(np.asarray(value).dtype)
    array[where] = value
    return replace(mesh, **{name: array})


def _raw(table: str, field: str, value) -> ngsolve.Mesh:
    """An ngsolve mesh, changed behind its back."""
    mesh = replace(CUBE).source  # one of its own, to be damaged
    if table == "Coordinates":
        mesh.ngmesh.Coordinates()[13] += value
    else:
        getattr(mesh.ngmesh, table)().NumPy()[field][3] = value
    return mesh


def _arrays():
    """What else is wrong with a mesh: tests/mesh/test_mesh_soundness.py."""
    for dim, mesh, labels in (("2D", SQUARE, VALUES), ("3D", CUBE, ("node n", "facet node -7"))):
        for label in labels:
            name, where, value = VALUES[label]
            yield Hostile(
                f"{dim} {label}",
                lambda m=mesh, w=(name, where, value): am.mesh.as_mesh(_set(m, *w)),
                name,
            )
    for label, (name, kind) in TYPES.items():
        yield Hostile(
            label, lambda n=name, k=kind: replace(SQUARE, **{n: getattr(SQUARE, n).astype(k)}), name
        )
    yield Hostile("points 1D", lambda: replace(SQUARE, points=SQUARE.points[:, :1]), "points")


def _objects():
    for table, field, value, says in (
        ("Elements3D", "nodes", 10**6, "nodes"),
        ("Elements3D", "nodes", 0, "nodes"),
        ("Elements3D", "index", 77, "material"),
        ("Elements3D", "index", -1, "material"),
        ("Elements2D", "index", 77, "face"),
        ("Elements2D", "nodes", 10**6, "facets"),
        ("Coordinates", "", 0.8, "folded over"),
        ("Coordinates", "", NAN, "points"),
    ):
        yield Hostile(
            f"ngsolve {table} {field} {value}",
            lambda t=table, f=field, v=value: am.mesh.as_mesh(_raw(t, f, v)),
            says,
        )
    yield Hostile(
        "ngsolve empty",
        lambda: am.mesh.as_mesh(ngsolve.Mesh(netgen.meshing.Mesh(dim=3))),
        "elements",
    )
    yield Hostile("netgen mesh", lambda: am.mesh.as_mesh(SQUARE.source.ngmesh), "mesh must be")
    yield Hostile("merged text", lambda: am.mesh.merged({"a": "mesh"}), "meshes")
    yield Hostile("merged name", lambda: am.mesh.merged({"a\nb": SQUARE}), "name")
    yield from each(
        "marked",
        lambda v: am.mesh.bisect(SQUARE, v),
        labelled((np.zeros(18, dtype=bool), np.zeros(18), np.ones(3, dtype=bool), None)),
    )
    yield from each("n_old", lambda v: am.mesh.onto_domain(None, SQUARE, v), labelled((-1, 17)))
    yield Hostile("refine_near 25", lambda: am.mesh.refine_near(SQUARE, "top", 25), "levels")
    yield Hostile("refine_near 3D", lambda: am.mesh.refine_near(CUBE, "top", 12), "levels")
    yield from each("boundaries", lambda v: am.mesh.refine_near(SQUARE, v), labelled(((), (1,))))


INPUTS = (*_arrays(), *_objects())
