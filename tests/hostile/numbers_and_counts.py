"""Numbers, counts and flags that cannot be what was meant: not numbers, not finite, out of range, absurdly large."""

from functools import cache

import numpy as np
from hostile_table import each, labelled, words

import adaptmg as am
from adaptmg.mesh import graded, sized, solid_mesh, structured

SQUARE, CUBE = am.Rectangle(width=1, height=1), am.Box(width=1, depth=1, height=1)
NAN = float("nan")
_KEYWORDS = (
    (am.PlaneStrain, "young", (-1.0, 1e300, 1e-300), {"poisson": 0.3}),
    (am.Rectangle, "width", (1e-200,), {"height": 1}),
    (am.Solid, "poisson", (NAN, np.nextafter(0.5, 0)), {"young": 1.0}), (am.Multigrid, "rtol", (1.0, 0.0), {}),
    (am.Pressure, "value", (1e300,), {"boundary": "top"}), (am.Support, "x", (1e200,), {"boundary": "right"}),
    (am.Traction, "components", ((1e300, 0.0),), {"boundary": "top"}),
    (am.InitialStrain, "components", ((1e300, 0.0),), {"body": "body"}), (am.LoadPath, "default", ([0.5, NAN],), {}),
    (am.ContactPair, "reach gap", (-1.0,), {"slave": "a", "master": "b"}), (am.SingleGrid, "omega", (2.0,), {}),
    (am.cases.greco_bar, "size top_pressure", (NAN,), {}), (am.CoarseSolve, "atol", (1.0, NAN), {}),
    (am.Doerfler, "theta", (0.0, 1.5), {}), (am.Remesh, "growth", (1.0,), {}), (am.Remesh, "finest", (1.0,), {}),
    (am.Remesh, "coarsest", (0.5,), {}),
    (am.Estimate, "squares", ([1.0, NAN], [-1.0], [], np.eye(2), [1j], [True, False]), {"norm": 1.0}),
    (am.Estimate, "norm", (-1.0,), {"squares": [1.0]}),
    (am.Estimate, "signed", (NAN,), {
        "squares": [1.0], "norm": 1.0, "value": 1.0}),
    (am.Estimate, "terms", ({"a": "b"}, {3: 1.0}), {
            "squares": [1.0], "norm": 1.0}),
)


@cache
def bar():
    return am.cases.greco_bar()


@cache
def grids():
    return am.Hierarchy.uniform(bar(), (2, 4))


def triangle(x=0.0, **options):
    make = am.Outline if options else am.Polygon
    return make(vertices=((0, 0), (1, 0), (x, 1)), boundaries=("a", "b", "c"), **options)


#: (call, values)
_CALLS = {
    "Coulomb friction": (lambda v: am.Coulomb(v).bounds(2), -1.0, 1e300),
    "Tresca limit": (lambda v: am.Tresca(v).bounds(2), -1.0, 1e300),
    "LoadPath factors['top']": (lambda v: am.LoadPath({"top": v}), [0.0, NAN], [1e300], [[1.0], [1.0, 2.0]], "12"),
    "Outline arcs[1]": (lambda v: triangle(arcs={1: (0, v)}), NAN), "Polygon vertices": (triangle, NAN),
    "graded size": (lambda v: graded(SQUARE, v), 0), "sized size": (lambda v: sized(SQUARE, v, 0.3), 1e-6),
    "structured divisions": (lambda v: structured(SQUARE, v), (2, 2, 2), 10**5, 10**400),
    "space divisions": (lambda v: structured(CUBE, v), 2**40),
    "uniform divisions": (lambda v: am.Hierarchy.uniform(bar(), v), (2.0, 4), (0, 4), range(2, 600)),
    "uniform from fine to coarse": (lambda v: am.Hierarchy.uniform(bar(), v), (4, 2)),
    "truncated finest": (lambda v: grids().truncated(finest=v), 5),
    "sized size_function": (lambda v: sized(SQUARE, v, 0.3), lambda x: x[:, 0] * NAN, lambda x: -x[:, 0] - 1,
                            lambda x: [1.0, 2.0]),
}
#: meshes of more nodes than fit
_LARGE = {
    "square": lambda: graded(SQUARE, 1e-6), "cube": lambda: graded(CUBE, 1e-300),
    "ball": lambda: graded(am.Ball((0, 0, 0), 1), 1e-100), "ratio": lambda: graded(SQUARE, 0.3, "top", 1e9),
    "ratio in space": lambda: graded(CUBE, 0.3, "top", 1e5),
    "round wire": lambda: solid_mesh(am.Cylinder((0, 0, 0), (0, 0, 1), 1e-4, 1), 1e-2, curvature=20)}

INPUTS = (
    *(row for make, names, values, given in _KEYWORDS for row in words(make, names, *values, **given)),
    *(row for argument, (call, *values) in _CALLS.items() for row in each(argument, call, labelled(values))),
    *each("mesh", lambda make: make(), _LARGE, says="sizes ask for"))
