"""Meshes as objects: arrays, ngsolve meshes and masks that are wrong."""

from dataclasses import replace

import netgen.meshing
import ngsolve
import numpy as np
from hostile_table import Hostile

import adaptmg as am
from adaptmg.mesh import (
    MeshArrays,
    as_mesh,
    bisect,
    from_ngsolve,
    merged,
    onto_domain,
    refine_near,
    structured,
    to_ngsolve,
)

SQUARE = structured(am.Rectangle(width=1, height=1), 3)
CUBE = structured(am.Box(width=1, depth=1, height=1), 2)
NAN = float("nan")

# array, place, value of another type or size
VALUES = {
    "node n": ("elements", (2, 0), 10**4), "node -1": ("elements", (2, 0), -1),
    "node 2**31": ("elements", (2, 0), 2**31), "node 2**63": ("elements", (2, 0), np.uint64(2**63)),
    "node 1.5": ("elements", (2, 0), 1.5), "facet node n": ("facets", (1, 0), 10**4),
    "facet node -7": ("facets", (1, 0), -7), "label 99": ("facet_labels", 1, 99),
    "label 2**40": ("facet_labels", 1, 2**40), "label .5": ("facet_labels", 1, 0.5), "body 5": ("element_body", 1, 5),
    "nan": ("points", (0, 0), NAN), "inf": ("points", (0, 0), float("inf")),
}
TYPES = {"nodes as floats": ("elements", float), "nodes as text": ("elements", str),
         "nodes as objects": ("elements", object), "facets as floats": ("facets", float),
         "points as text": ("points", str), "complex points": ("points", complex)}


def _set(mesh: MeshArrays, name: str, where, value) -> MeshArrays:
    array = getattr(mesh, name).astype(np.asarray(value).dtype)
    array[where] = value
    return replace(mesh, source=None, **{name: array})


def _moved(mesh: MeshArrays, node: int, by: float) -> MeshArrays:
    return _set(mesh, "points", node, mesh.points[node] + by)


def _raw(table: str, field: str, value) -> ngsolve.Mesh:
    """An ngsolve mesh, changed behind its back."""
    mesh = to_ngsolve(CUBE.points, CUBE.elements, CUBE.facets, CUBE.facet_labels, CUBE.boundaries)
    if table == "Coordinates":
        mesh.ngmesh.Coordinates()[13] += value
    else:
        getattr(mesh.ngmesh, table)().NumPy()[field][3] = value
    return mesh


def _arrays():
    for dim, mesh in (("2D", SQUARE), ("3D", CUBE)):
        inner = int(np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)[0])
        changes = {label: (name, lambda m=mesh, n=name, w=where, v=value: _set(m, n, w, v))
                   for label, (name, where, value) in VALUES.items()}
        changes |= {label: (name, lambda m=mesh, n=name, k=kind: replace(m, **{n: getattr(m, n).astype(k)}))
                    for label, (name, kind) in TYPES.items()}
        changes |= {
            "bodies two": ("bodies", lambda m=mesh: replace(m, bodies=("a", "a"))),
            "points 1D": ("points", lambda m=mesh: replace(m, points=m.points[:, :1])),
            "points 4D": ("points", lambda m=mesh: replace(m, points=np.zeros((m.n_nodes, 4)))),
            # arrays are taken unchanged, elements are not turned
            "folded over": ("inverted", lambda m=mesh, i=inner: _moved(m, i, 0.8)),
            "corner through": ("inverted", lambda m=mesh: _moved(m, 0, 1.7)),
            "element twice": ("elements", lambda m=mesh: replace(
                m, elements=np.vstack([m.elements, m.elements[:1]]), element_body=None)),
            "element left out": ("boundary facets are no", lambda m=mesh: replace(
                m, elements=m.elements[1:], element_body=None)),
            "flat": ("degenerate", lambda m=mesh: _set(m, "points", m.elements[0, 0], m.points[m.elements[0, 1]])),
            "unused node": ("nodes", lambda m=mesh: replace(m, points=np.vstack([m.points, m.points[:1] + 9]))),
        }
        for label, (says, make) in changes.items():
            if dim == "3D" and label not in ("node n", "facet node -7", "folded over", "corner through", "flat"):
                continue  # the same checks
            yield Hostile(f"{dim} {label}", lambda f=make: as_mesh(replace(f(), source=None)), says)


def _objects():
    for table, field, value, says in (
            ("Elements3D", "nodes", 10**6, "nodes"), ("Elements3D", "nodes", 0, "nodes"),
            ("Elements3D", "index", 77, "material"), ("Elements3D", "index", -1, "material"),
            ("Elements2D", "index", 77, "face"), ("Elements2D", "nodes", 10**6, "facets"),
            ("Coordinates", "", 0.8, "folded over"), ("Coordinates", "", NAN, "points")):
        yield Hostile(f"ngsolve {table} {field} {value}",
                      lambda t=table, f=field, v=value: from_ngsolve(_raw(t, f, v)), says)
    yield Hostile("ngsolve empty", lambda: as_mesh(ngsolve.Mesh(netgen.meshing.Mesh(dim=3))), "elements")
    yield Hostile("netgen mesh", lambda: as_mesh(SQUARE.source.ngmesh), "mesh must be")
    yield Hostile("merged text", lambda: merged({"a": "mesh"}), "meshes")
    for label, name in {"dot": "a.b", "control": "a\nb"}.items():
        yield Hostile(f"merged name {label}", lambda n=name: merged({n: SQUARE}), "name")
    masks = {"none": np.zeros(18, dtype=bool), "numbers": np.zeros(18), "short": np.ones(3, dtype=bool), "text": "all",
             "indices": np.array([1, 2]), "None": None}
    for label, mask in masks.items():
        yield Hostile(f"bisect {label}", lambda m=mask: bisect(SQUARE, m), "marked")
    for old in (-1, "all", 17):
        yield Hostile(f"onto_domain {old}", lambda n=old: onto_domain(None, SQUARE, n), "n_old")
    for levels in (0, 25, 10**400):
        yield Hostile(f"refine_near {str(levels)[:5]}", lambda n=levels: refine_near(SQUARE, "top", n), "levels")
    yield Hostile("refine_near 3D", lambda: refine_near(CUBE, "top", 12), "levels")
    yield Hostile("bisected 40", lambda: am.Hierarchy.bisected(
        am.cases.greco_bar(), structured(am.cases.greco_bar().domain, 2), 40), "levels")
    for names in ("nowhere", (), (1,)):
        yield Hostile(f"refine_near boundaries {names}", lambda n=names: refine_near(SQUARE, n), "boundar")


INPUTS = (*_arrays(), *_objects())
