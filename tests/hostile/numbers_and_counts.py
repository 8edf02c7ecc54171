"""Numbers, counts and flags that cannot be what was meant: not numbers, not finite, out of range, absurdly large."""

from functools import cache

import numpy as np
from arrays_and_matrices import discrete
from hostile_table import each, labelled, words

import adaptmg as am
from adaptmg.mesh import graded, sized, solid_mesh, structured

SQUARE, CUBE = am.Rectangle(width=1, height=1), am.Box(width=1, depth=1, height=1)
NAN = float("nan")
NUMBERS = {"nan": NAN, "True": True, "text": "1", "bytes": b"1", "complex": 1j, "infinite": float("inf"), "None": None,
           "list": [-1.0], "ragged": [[1.0], [1.0, 2.0]], "masked": np.ma.masked, "class": float, "10**400": 10**400,
           "negative": -1.0}
COUNTS = {"float": 2.0, "True": True, "text": "2", "None": None, "nan": NAN, "negative": -3}
PLANE = am.Plane((0, 0), (0, 1))
#: a function, keyword arguments of it, their values, and its other arguments
_KEYWORDS = (
    (am.PlaneStrain, "young", (-1.0, 1e300, 1e-300), {"poisson": 0.3}),
    (am.Solid, "poisson", (NAN, np.nextafter(0.5, 0)), {"young": 1.0}),
    (am.Rectangle, "width", (1e-200,), {"height": 1.0}), (am.Plane, "point", ((0, NAN),), {"normal": (0, 1)}),
    (am.Pressure, "value", (NAN, 1e300), {"boundary": "top"}), (am.Support, "x", (NAN, 1e200), {"boundary": "right"}),
    (am.Traction, "components", ((0.0, NAN), (1e300, 0.0)), {"boundary": "top"}),
    (am.InitialStrain, "components", ((1e300, 0.0),), {"body": "body"}), (am.LoadPath, "default", ([0.5, NAN],), {}),
    (am.ContactPair, "reach gap", (NAN, -1.0), {"slave": "a", "master": "b"}),
    (am.cases.greco_bar, "size top_pressure", (NAN,), {}), (am.Multigrid, "rtol", (1.0, 0.0), {}),
    *((method, "rtol", (NAN, 1e30), {}) for method in (
        am.SingleGrid, am.FullMultigrid, am.ActiveSet, am.NestedStart, am.CoarseSolve)),
    (am.ProjectedGaussSeidel, "omega", (NAN,), {}), (am.SingleGrid, "omega", (NAN,), {}),
    (am.AMG, "max_iterations", (2.0,), {}), (am.SingleGrid, "max_sweeps", (2.0,), {}),
    (am.ActiveSet, "max_steps", (2.0,), {}), (am.Cycle, "pre", (2.0,), {}), (am.NestedStart, "cycles", (2.0,), {}),
    (am.Truncated, "recombine interface_sweeps", (2.0,), {}), (am.ProjectedGaussSeidel, "friction_update", (2.0,), {}),
    (am.Contact, "allow_interference", ("no", 1), {"boundary": "a", "obstacle": PLANE}),
    (am.ContactPair, "allow_interference", ("no",), {"slave": "a", "master": "b"}),
    (am.SingleGrid, "condensed", ("no",), {}), (am.CoarseSolve, "condensed", ("no",), {}),
    (am.cases.greco_block, "plane_strain", ("no",), {}),
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
    "Coulomb friction": (lambda v: am.Coulomb(v).bounds(2), *NUMBERS.values(), 1e300),
    "Tresca limit": (lambda v: am.Tresca(v).bounds(2), NAN, -1.0, 1e300),
    "LoadPath factors['top']": (lambda v: am.LoadPath({"top": v}), [0.0, NAN], [1e300]),
    "Polygon vertices": (triangle, NAN), "Outline arcs[1]": (lambda v: triangle(arcs={1: (0, v)}), NAN),
    "graded size": (lambda v: graded(SQUARE, v), NAN, 0), "sized max_size": (lambda v: sized(SQUARE, 0.1, v), NAN),
    "solid size": (lambda v: solid_mesh(CUBE, v), NAN), "sized size": (lambda v: sized(SQUARE, v, 0.3), 1e-6),
    "graded contact_ratio": (lambda v: graded(SQUARE, 0.3, "top", v), NAN),
    "graded grading": (lambda v: graded(SQUARE, 0.3, "top", 2, v), NAN),
    "Hierarchy.graded size": (lambda v: am.Hierarchy.graded(bar(), (v,)), NAN),
    "Hierarchy.graded contact_ratio": (lambda v: am.Hierarchy.graded(bar(), (0.02,), contact_ratio=v), NAN),
    "algebraic strength": (lambda v: am.Hierarchy.algebraic(discrete(), strength=v), NAN),
    "algebraic max_coarse": (lambda v: am.Hierarchy.algebraic(discrete(), max_coarse=v), 2.0),
    "structured divisions": (lambda v: structured(SQUARE, v), *COUNTS.values(), (2, 2, 2), 10**5, 10**400),
    "space divisions": (lambda v: structured(CUBE, v), 2**40),
    "uniform divisions": (lambda v: am.Hierarchy.uniform(bar(), v), (2.0, 4), (0, 4), range(2, 600)),
    "uniform from fine to coarse": (lambda v: am.Hierarchy.uniform(bar(), v), (4, 2)),
    "bisected levels": (lambda v: am.Hierarchy.bisected(bar(), grids()[0].mesh, v), 2.0),
    "truncated coarsest": (lambda v: grids().truncated(coarsest=v), 2.0),
    "truncated finest": (lambda v: grids().truncated(finest=v), 5),
    "from_meshes contact_rows": (lambda v: am.Hierarchy.from_meshes(
        bar(), [g.mesh for g in grids()], contact_rows=v), "no"),
    "solve throw": (lambda v: am.solve(grids(), throw=v), "no"),
    "solve_path throw": (lambda v: am.solve_path(grids(), am.LoadPath(), throw=v), "no"),
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
    *each("every number width", lambda v: am.Rectangle(width=v, height=1.0), NUMBERS),
    *each("every number rtol", lambda v: am.Multigrid(rtol=v), NUMBERS),
    *each("every count max_cycles", lambda v: am.Multigrid(max_cycles=v), COUNTS),
    *each("mesh", lambda make: make(), _LARGE, says="sizes ask for"))
