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
    check_mesh,
    coarsen,
    from_ngsolve,
    merged,
    onto_domain,
    refine_near,
    structured,
    to_ngsolve,
)

SQUARE = structured(am.Rectangle(width=1, height=1), 3)
CUBE = structured(am.Box(width=1, depth=1, height=1), 2)
NAN, INF = float("nan"), float("inf")


def _set(mesh: MeshArrays, name: str, where, value) -> MeshArrays:
    array = getattr(mesh, name).astype(np.asarray(value).dtype if name != "points" else float)
    array[where] = value
    return replace(mesh, source=None, **{name: array})


def _moved(mesh: MeshArrays, node: int, by) -> MeshArrays:
    points = mesh.points.copy()
    points[node] += by
    return replace(mesh, points=points, source=None)


def _raw(change) -> ngsolve.Mesh:
    """An ngsolve mesh, changed behind its back."""
    mesh = to_ngsolve(CUBE.points, CUBE.elements, CUBE.facets, CUBE.facet_labels, CUBE.boundaries)
    change(mesh.ngmesh)
    return mesh


def _write(table: str, field: str, value):
    def change(ngmesh) -> None:
        getattr(ngmesh, table)().NumPy()[field][3] = value
    return change


def _arrays():
    for dim, mesh in (("2D", SQUARE), ("3D", CUBE)):
        n, inner = mesh.n_nodes, int(np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)[0])
        changes = {
            "node n": ("elements", lambda m=mesh, n=n: _set(m, "elements", (2, 0), np.int64(n))),
            "node -1": ("elements", lambda m=mesh: _set(m, "elements", (2, 0), np.int64(-1))),
            "node 2**31": ("elements", lambda m=mesh: _set(m, "elements", (2, 0), np.int64(2**31))),
            "node 2**32": ("elements", lambda m=mesh: _set(m, "elements", (2, 0), np.int64(2**32))),
            "node 2**63": ("elements", lambda m=mesh: _set(m, "elements", (2, 0), np.uint64(2**63))),
            "node 1.5": ("elements", lambda m=mesh: _set(m, "elements", (2, 0), 1.5)),
            "nodes as floats": ("elements", lambda m=mesh: replace(m, elements=m.elements.astype(float))),
            "nodes as text": ("elements", lambda m=mesh: replace(m, elements=m.elements.astype(str))),
            "nodes as objects": ("elements", lambda m=mesh: replace(m, elements=m.elements.astype(object))),
            "facet node n": ("facets", lambda m=mesh, n=n: _set(m, "facets", (1, 0), np.int64(n))),
            "facet node -7": ("facets", lambda m=mesh: _set(m, "facets", (1, 0), np.int64(-7))),
            "facets as floats": ("facets", lambda m=mesh: replace(m, facets=m.facets.astype(float))),
            "label 99": ("facet_labels", lambda m=mesh: _set(m, "facet_labels", 1, np.int64(99))),
            "label -1": ("facet_labels", lambda m=mesh: _set(m, "facet_labels", 1, np.int64(-1))),
            "label 2**40": ("facet_labels", lambda m=mesh: _set(m, "facet_labels", 1, np.int64(2**40))),
            "label .5": ("facet_labels", lambda m=mesh: _set(m, "facet_labels", 1, 0.5)),
            "body 5": ("element_body", lambda m=mesh: _set(m, "element_body", 1, np.int64(5))),
            "bodies two": ("bodies", lambda m=mesh: replace(m, bodies=("a", "a"))),
            "nan": ("points", lambda m=mesh: _set(m, "points", (0, 0), NAN)),
            "inf": ("points", lambda m=mesh: _set(m, "points", (0, 0), INF)),
            "complex points": ("points", lambda m=mesh: replace(m, points=m.points + 1j)),
            "points as text": ("points", lambda m=mesh: replace(m, points=m.points.astype(str))),
            "points 1D": ("points", lambda m=mesh: replace(m, points=m.points[:, :1])),
            "points 4D": ("points", lambda m=mesh: replace(m, points=np.zeros((m.n_nodes, 4)))),
            # arrays are taken as they are, elements are not turned
            "folded over": ("inverted", lambda m=mesh, i=inner: _moved(m, i, 0.8)),
            "far outside": ("inverted", lambda m=mesh, i=inner: _moved(m, i, 50.0)),
            "corner through": ("inverted", lambda m=mesh: _moved(m, 0, 1.7)),
            "element twice": ("elements", lambda m=mesh: replace(
                m, elements=np.vstack([m.elements, m.elements[:1]]), element_body=None)),
            "element left out": ("boundary facets are no", lambda m=mesh: replace(
                m, elements=m.elements[1:], element_body=None)),
            "flat": ("degenerate", lambda m=mesh: _set(m, "points", m.elements[0, 0], m.points[m.elements[0, 1]])),
            "unused node": ("nodes", lambda m=mesh: replace(m, points=np.vstack([m.points, m.points[:1] + 9]))),
        }
        for label, (says, make) in changes.items():
            yield Hostile(f"{dim} {label}", lambda f=make: as_mesh(replace(f(), source=None)), says)


def _objects():
    raw = {"node": ("Elements3D", "nodes", 10**6, "nodes"), "node 0": ("Elements3D", "nodes", 0, "nodes"),
           "material": ("Elements3D", "index", 77, "material"), "face": ("Elements2D", "index", 77, "face"),
           "material -1": ("Elements3D", "index", -1, "material"),
           "face node": ("Elements2D", "nodes", 10**6, "facets")}
    for label, (table, field, value, says) in raw.items():
        yield Hostile(f"ngsolve {label}", lambda t=table, f=field, v=value: from_ngsolve(_raw(_write(t, f, v))), says)

    def fold(ngmesh) -> None:
        ngmesh.Coordinates()[13] += 0.8

    yield Hostile("ngsolve folded over", lambda: as_mesh(_raw(fold)), "folded over")
    yield Hostile("ngsolve nan", lambda: as_mesh(_raw(lambda m: m.Coordinates().__setitem__(13, NAN))), "points")
    yield Hostile("ngsolve empty", lambda: as_mesh(ngsolve.Mesh(netgen.meshing.Mesh(dim=3))), "elements")
    yield Hostile("netgen mesh", lambda: as_mesh(SQUARE.source.ngmesh), "mesh must be")
    for label, value in {"None": None, "number": 3, "list": [1], "class": MeshArrays, "bytes": b"a.msh"}.items():
        yield Hostile(f"as_mesh {label}", lambda v=value: as_mesh(v), "mesh")
        yield Hostile(f"check_mesh {label}", lambda v=value: check_mesh(v), "mesh")
        yield Hostile(f"merged {label}", lambda v=value: merged({"a": v}), "meshes")
    for label, name in {"dot": "a.b", "empty": "", "number": 3, "control": "a\nb"}.items():
        yield Hostile(f"merged name {label}", lambda n=name: merged({n: SQUARE}), "name")
    masks = {"numbers": np.zeros(18), "short": np.ones(3, dtype=bool), "none": np.zeros(18, dtype=bool), "text": "all",
             "indices": np.array([1, 2]), "None": None}
    for label, mask in masks.items():
        yield Hostile(f"bisect {label}", lambda m=mask: bisect(SQUARE, m), "marked")
        if label != "none":
            yield Hostile(f"coarsen {label}", lambda m=mask: coarsen(SQUARE, m), "marked")
    everything = np.ones(18, dtype=bool)
    for label, passes in {"0": 0, "1.5": 1.5, "True": True, "text": "all", "10**400": 10**400}.items():
        yield Hostile(f"bisect passes {label}", lambda n=passes: bisect(SQUARE, everything, n), "passes")
        yield Hostile(f"coarsen passes {label}", lambda n=passes: coarsen(SQUARE, everything, n), "passes")
        yield Hostile(f"Bisect passes {label}", lambda n=passes: am.Bisect(passes=n), "passes")
    for label, old in {"-1": -1, "text": "all", "17": 17, "None": None}.items():
        yield Hostile(f"onto_domain {label}", lambda n=old: onto_domain(None, SQUARE, n), "n_old")
    for label, value in {"True": True, "1": 1, "text": "x", "nan": NAN, "None": None}.items():
        yield Hostile(f"Bisect coarsen {label}", lambda v=value: am.Bisect(coarsen=v), "coarsen")
    for label, levels in {"0": 0, "-1": -1, "25": 25, "60": 60, "10**9": 10**9, "1.5": 1.5, "True": True,
                          "10**400": 10**400}.items():
        yield Hostile(f"refine_near {label} levels", lambda n=levels: refine_near(SQUARE, "top", n), "levels")
    yield Hostile("refine_near 3D", lambda: refine_near(CUBE, "top", 12), "levels")
    yield Hostile("bisected 40", lambda: am.Hierarchy.bisected(
        am.cases.greco_bar(), structured(am.cases.greco_bar().domain, 2), 40), "levels")
    for label, names in {"unknown": "nowhere", "empty": (), "numbers": (1,), "None": None}.items():
        yield Hostile(f"refine_near boundaries {label}", lambda n=names: refine_near(SQUARE, n), "boundar")


INPUTS = (*_arrays(), *_objects())
