"""Numbers, counts and flags that cannot be what was meant: not numbers, not finite, out of range, absurdly large."""

from functools import cache

import numpy as np
from arrays_and_matrices import discrete
from hostile_table import Hostile, each

import adaptmg as am
from adaptmg.mesh import graded, sized, solid_mesh, structured

SQUARE, CUBE = am.Rectangle(width=1, height=1), am.Box(width=1, depth=1, height=1)
NUMBERS = {"nan": float("nan"), "True": True, "text": "1", "bytes": b"1", "complex": 1j, "infinite": float("inf"),
           "None": None, "list": [-1.0], "ragged": [[1.0], [1.0, 2.0]], "masked": np.ma.masked, "class": float,
           "10**400": 10**400, "negative": -1.0}
COUNTS = {"float": 2.0, "True": True, "text": "2", "None": None, "nan": float("nan"), "negative": -3}
FLAGS = {"text": "no", "number": 1}


@cache
def bar():
    return am.cases.greco_bar()


@cache
def grids():
    return am.Hierarchy.uniform(bar(), (2, 4))


def triangle(x=0.0, **options):
    make = am.Outline if options else am.Polygon
    return make(vertices=((0, 0), (1, 0), (x, 1)), boundaries=("a", "b", "c"), **options)


#: these take every value of NUMBERS
_IN_FULL = {
    "Rectangle width": lambda v: am.Rectangle(width=v, height=1.0),
    "Coulomb friction": lambda v: am.Coulomb(v).bounds(2),
    "Multigrid rtol": lambda v: am.Multigrid(rtol=v),
}
_NUMBERS = {
    "PlaneStrain young": lambda v: am.PlaneStrain(young=v, poisson=0.3),
    "Solid poisson": lambda v: am.Solid(young=1.0, poisson=v),
    "Pressure value": lambda v: am.Pressure("top", v),
    "Traction components": lambda v: am.Traction("top", (0.0, v)),
    "Support x": lambda v: am.Support("right", x=v),
    "Tresca limit": lambda v: am.Tresca(v).bounds(2),
    "Plane point": lambda v: am.Plane((0.0, v), (0.0, 1.0)),
    "ContactPair reach": lambda v: am.ContactPair("a", "b", reach=v),
    "ContactPair gap": lambda v: am.ContactPair("a", "b", gap=v),
    "LoadPath factors['top']": lambda v: am.LoadPath({"top": [0.0, v]}),
    "LoadPath default": lambda v: am.LoadPath(default=[0.5, v]),
    "Polygon vertices": triangle,
    "Outline arcs[1]": lambda v: triangle(arcs={1: (0, v)}),
    "case size": lambda v: am.cases.greco_bar(size=v),
    "case top_pressure": lambda v: am.cases.greco_bar(top_pressure=v),
    "graded size": lambda v: graded(SQUARE, v),
    "sized max_size": lambda v: sized(SQUARE, 0.1, v),
    "solid size": lambda v: solid_mesh(CUBE, v),
    "graded contact_ratio": lambda v: graded(SQUARE, 0.3, "top", v),
    "graded grading": lambda v: graded(SQUARE, 0.3, "top", 2, v),
    "Hierarchy.graded size": lambda v: am.Hierarchy.graded(bar(), (v,)),
    "Hierarchy.graded contact_ratio": lambda v: am.Hierarchy.graded(bar(), (0.02,), contact_ratio=v),
    "SingleGrid rtol": lambda v: am.SingleGrid(rtol=v),
    "FullMultigrid rtol": lambda v: am.FullMultigrid(rtol=v),
    "ActiveSet rtol": lambda v: am.ActiveSet(rtol=v),
    "NestedStart rtol": lambda v: am.NestedStart(rtol=v),
    "CoarseSolve rtol": lambda v: am.CoarseSolve(rtol=v),
    "ProjectedGaussSeidel omega": lambda v: am.ProjectedGaussSeidel(omega=v),
    "SingleGrid omega": lambda v: am.SingleGrid(omega=v),
    "algebraic strength": lambda v: am.Hierarchy.algebraic(discrete(), strength=v),
}
_COUNTS_IN_FULL = {
    "structured divisions": lambda v: structured(SQUARE, v),
    "Multigrid max_cycles": lambda v: am.Multigrid(max_cycles=v),
}
_COUNTS = {
    "AMG max_iterations": lambda v: am.AMG(max_iterations=v),
    "SingleGrid max_sweeps": lambda v: am.SingleGrid(max_sweeps=v),
    "ActiveSet max_steps": lambda v: am.ActiveSet(max_steps=v),
    "Cycle pre": lambda v: am.Cycle(pre=v),
    "NestedStart cycles": lambda v: am.NestedStart(cycles=v),
    "Truncated recombine": lambda v: am.Truncated(recombine=v),
    "Truncated interface_sweeps": lambda v: am.Truncated(interface_sweeps=v),
    "smoother friction_update": lambda v: am.ProjectedGaussSeidel(friction_update=v),
    "algebraic max_coarse": lambda v: am.Hierarchy.algebraic(discrete(), max_coarse=v),
    "uniform divisions": lambda v: am.Hierarchy.uniform(bar(), (v, 4)),
    "bisected levels": lambda v: am.Hierarchy.bisected(bar(), grids()[0].mesh, v),
    "truncated coarsest": lambda v: grids().truncated(coarsest=v),
}
_FLAGS = {
    "Contact allow_interference": lambda v: am.Contact("a", am.Plane((0, 0), (0, 1)), allow_interference=v),
    "ContactPair allow_interference": lambda v: am.ContactPair("a", "b", allow_interference=v),
    "SingleGrid condensed": lambda v: am.SingleGrid(condensed=v),
    "CoarseSolve condensed": lambda v: am.CoarseSolve(condensed=v),
    "case plane_strain": lambda v: am.cases.greco_block(plane_strain=v),
    "from_meshes contact_rows": lambda v: am.Hierarchy.from_meshes(
        bar(), [grids()[0].mesh, grids()[1].mesh], contact_rows=v),
    "solve throw": lambda v: am.solve(grids(), throw=v),
    "solve_path throw": lambda v: am.solve_path(grids(), am.LoadPath(), throw=v),
}


def _by_type():
    for in_full, rest, values, few in ((_IN_FULL, _NUMBERS, NUMBERS, ("nan",)),
                                       (_COUNTS_IN_FULL, _COUNTS, COUNTS, ("float",)), ({}, _FLAGS, FLAGS, ("text",))):
        for argument, call in in_full.items():
            yield from each(argument, call, values)
        for argument, call in rest.items():
            yield from each(argument, call, values, few)


def _size_fields():
    values = {"nan": lambda x: x[:, 0] * float("nan"), "negative": lambda x: -x[:, 0] - 1,
              "one number": lambda x: [1.0, 2.0]}
    yield from each("sized size_function", lambda v: sized(SQUARE, v, 0.3), values)


#: (argument, value, call)
_OUT_OF_RANGE = (
    ("rtol 1", lambda: am.Multigrid(rtol=1.0), "rtol"),
    ("rtol 1e30", lambda: am.FullMultigrid(rtol=1e30), "rtol"),
    ("rtol zero", lambda: am.NestedStart(rtol=0.0), "rtol"),
    ("size zero", lambda: graded(SQUARE, 0), "size"),
    ("young 1e300", lambda: am.PlaneStrain(young=1e300, poisson=0.3), "young"),
    ("young 1e-300", lambda: am.PlaneStrain(young=1e-300, poisson=0.3), "young"),
    ("width 1e-200", lambda: am.Rectangle(width=1e-200, height=1.0), "width"),
    ("pressure 1e300", lambda: am.Pressure("top", 1e300), "value"),
    ("traction 1e300", lambda: am.Traction("top", (1e300, 0.0)), "components"),
    ("displacement 1e200", lambda: am.Support("right", x=1e200), "x"),
    ("friction 1e300", lambda: am.Coulomb(1e300), "friction"),
    ("limit 1e300", lambda: am.Tresca(1e300), "limit"),
    ("poisson nearly one half", lambda: am.PlaneStrain(young=1.0, poisson=np.nextafter(0.5, 0)), "poisson"),
    ("strain 1e300", lambda: am.InitialStrain("body", (1e300, 0.0)), "components"),
    ("path factor 1e300", lambda: am.LoadPath({"top": [1e300]}), "factors['top']"),
    ("divisions zero", lambda: am.Hierarchy.uniform(bar(), (0, 4)), "divisions"),
    ("divisions fine to coarse", lambda: am.Hierarchy.uniform(bar(), (4, 2)), "coarse to fine"),
    ("divisions without end", lambda: am.Hierarchy.uniform(bar(), range(2, 600)), "divisions"),
    ("divisions three in the plane", lambda: structured(SQUARE, (2, 2, 2)), "divisions"),
    ("divisions 10**5", lambda: structured(SQUARE, 10**5), "divisions"),
    ("divisions 2**40 in space", lambda: structured(CUBE, 2**40), "divisions"),
    ("divisions 10**400", lambda: structured(SQUARE, 10**400), "divisions"),
    ("finest beyond", lambda: grids().truncated(finest=5), "finest"),
    ("square of 1e-6", lambda: graded(SQUARE, 1e-6), "sizes ask for"),
    ("cube of 1e-300", lambda: graded(CUBE, 1e-300), "sizes ask for"),
    ("ball of 1e-100", lambda: graded(am.Ball((0, 0, 0), 1), 1e-100), "sizes ask for"),
    ("field of 1e-6", lambda: sized(SQUARE, 1e-6, 0.3), "size"),
    ("ratio 1e9", lambda: graded(SQUARE, 0.3, "top", 1e9), "sizes ask for"),
    ("ratio 1e5 in space", lambda: graded(CUBE, 0.3, "top", 1e5), "sizes ask for"),
    ("round wire", lambda: solid_mesh(am.Cylinder((0, 0, 0), (0, 0, 1), 1e-4, 1), 1e-2, curvature=20), "sizes ask for"),
)

INPUTS = (*_by_type(), *_size_fields(), *(Hostile(*row) for row in _OUT_OF_RANGE))
