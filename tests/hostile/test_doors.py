"""Every public class and function refuses values of another type for each argument and names that argument."""

import dataclasses
import inspect
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arrays_and_matrices import contact, discrete, grids

import adaptmg as am
from adaptmg import mesh as meshes

SQUARE = am.Polygon(vertices=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), boundaries=tuple("abcd"))
BALL, PLANE = am.Ball((0.0, 0.0, 0.0), 1.0), am.Plane((0.0, 0.0), (0.0, 1.0))
UNIT = am.Rectangle(width=1, height=1)
ELASTIC = {"young": 1e9, "poisson": 0.3}
NAN, TEXT, OTHER = float("nan"), "\udc80", object()
#: wrong values by the type of a right one: its class, another object, and what a careless check lets pass
WRONG = {float: (NAN, True, "1", b"1", 1j, float("inf"), None, [-1.0], [[1.0], [1.0, 2.0]], np.ma.masked, float,
                 10**400),
         int: (2.5, 2.0, True, "2", None, NAN, -3, 10**400), bool: ("no", 1, None, np.ones(2)),
         str: (5, "", None, ["right"], "a\0b", "a\x1b", TEXT), tuple: (None, 5, (NAN, 1.0), (1.0, 1j), "ab", ((1.0,),)),
         list: (None, "glue", [OTHER]), dict: ({TEXT: 1.0}, 3, "a")}
FEW = {float: (NAN, True, "1"), int: (2.5, True, -3), bool: ("no",), str: (5, TEXT), tuple: (5, "a"),
       list: ("glue", [OTHER]), dict: (3,)}
#: classes all of whose arguments get all wrong values: each kind of check is among them
THOROUGH = {am.Rectangle, am.Cycle, am.Support, am.Contact, am.SingleGrid, am.Plane, am.Coulomb}


@cache
def bar():
    return am.cases.greco_bar()


def mesh():
    return grids().finest.mesh


def mask():
    return np.ones(len(mesh().elements), dtype=bool)


def estimate():
    return am.Estimate(squares=np.ones(len(mesh().elements)), norm=1.0)


def adapted(**given):
    return list(am.adapt(bar(), 20e-3, **({"engine": am.Bisect(), "max_nodes": 60} | given)))


#: a door and arguments that it takes
DOORS = {
    am.ActiveSet: {"linear": am.Direct(), "rtol": 0.1, "max_steps": 2,
                                                  "nested_start": False, "condensed": True},
    am.Assembly: {"parts": {"a": UNIT}}, am.Axisymmetric: ELASTIC, am.PlaneStrain: ELASTIC, am.PlaneStress: ELASTIC,
    am.Solid: ELASTIC, am.Ball: {"centre": (0.0, 0.0, 0.0), "radius": 1.0}, am.Bisect: {"passes": 2},
    am.BodyForce: {"components": (0.0, 1.0), "body": "a"},
    am.Box: {"width": 1.0, "depth": 1.0, "height": 1.0, "origin": (0.0, 0.0, 0.0)},
    am.Circle: {"centre": (0.0, 0.0), "radius": 1.0, "boundary": "a"},
    am.CoarseSolve: {"condensed": True, "rtol": 0.1, "test": "error", "omega": 1.0, "max_sweeps": 2},
    am.Common: {"a": BALL, "b": BALL}, am.Cut: {"a": BALL, "b": BALL, "rename": {}}, am.Fuse: {"a": BALL, "b": BALL},
    am.Contact: {"boundary": "a", "obstacle": PLANE, "allow_interference": False, "law": am.Coulomb(0.3)},
    am.ContactForce: {"boundary": "a", "direction": "x"}, am.Opening: {"boundary": "a", "point": (0.0, 0.0)},
    am.ContactPair: {"slave": "a", "master": "b", "coupling": "mortar", "allow_interference": False, "reach": 1.0},
    am.ContactProblem: {"material": am.PlaneStrain(**ELASTIC), "contact": am.Contact("a", PLANE),
                        "law": am.Coulomb(0.3), "loads": [am.Pressure("c", 1.0)],
                        "supports": [am.Support("b", x=0.0)], "domain": SQUARE, "name": "a", "reference": {}},
    am.Coulomb: {"friction": 0.3}, am.Tresca: {"limit": 1.0}, am.Cycle: {"shape": "V", "pre": 2, "post": 1},
    am.Cylinder: {"point": (0.0, 0.0, 0.0), "axis": (0.0, 0.0, 1.0), "radius": 1.0, "height": 1.0},
    am.Displacement: {"points": (0.0, 0.0), "component": "x", "body": "a"}, am.Doerfler: {"theta": 0.5},
    am.Estimate: {"squares": (1.0,), "norm": 1.0, "terms": {}},
    am.Extrusion: {"polygon": SQUARE, "height": 1.0, "base": 0.0}, am.GapFunction: {"function": len},
    am.Moving: {"obstacle": PLANE, "displacement": (0.0, 1.0), "rotation": 0.1, "about": (0.0, 0.0), "name": "a"},
    am.Rigid: {"obstacle": PLANE, "force": (None, 1.0), "moment": 0.0, "about": (0.0, 0.0), "name": "a"},
    am.Preload: {"body": "a", "force": 1.0, "axis": "y", "at": 0.5, "name": "a"},
    am.Cracked: {"domain": SQUARE, "cracks": {"c": ((0.2, 0.5), (0.8, 0.5))}},
    am.Multigrid: {"cycle": am.Cycle(), "smoother": am.ProjectedGaussSeidel(), "correction": am.Monotone(),
                   "coarse": am.CoarseSolve(), "coarse_matrices": "galerkin", "stop": "error", "rtol": 0.1,
                   "max_cycles": 2},
    am.FullMultigrid: {"start": am.NestedStart(), "max_cycles": 2}, am.Goal: {"quantity": am.ContactForce()},
    am.Hierarchy: {"levels": lambda: grids().levels, "problem": bar},
    am.Level: {"discrete": lambda: grids()[0].discrete, "mesh": mesh},
    am.InitialStrain: {"body": "a", "components": (0.0, 1.0)}, am.LoadPath: {"factors": {"top": [1.0]},
                                                                             "default": 1.0},
    am.Maximum: {"theta": 0.5}, am.MeanDisplacement: {"boundary": "a", "component": "x"},
    am.Moved: {"solid": BALL, "offset": (0.0, 0.0, 1.0), "angle": 1.0, "axis": (0.0, 0.0, 1.0)},
    am.NestedStart: {"cycles": 2, "rtol": 0.1}, am.Plane: {"point": (0.0, 0.0), "normal": (0.0, 1.0)},
    am.Outline: {"vertices": SQUARE.vertices, "boundaries": tuple("abcd"), "arcs": {}},
    am.Polygon: {"vertices": SQUARE.vertices, "boundaries": tuple("abcd")},
    am.PaperCorrection: {"gap": "smallest", "slip": "initial", "limit": "initial"},
    am.PointSpring: {"point": (0.0, 0.0), "x": 1.0, "body": "a"}, am.Pressure: {"boundary": "a", "value": 1.0},
    am.PointSupport: {"point": (0.0, 0.0), "x": 1.0, "body": "a"},
    am.ProjectedGaussSeidel: {"omega": 1.0, "order": "forward"},
    am.Rectangle: {"width": 1.0, "height": 1.0, "origin": (0.0, 0.0)},
    am.Remesh: {"growth": 2.0, "finest": 0.1, "coarsest": 2.0},
    am.Revolution: {"polygon": SQUARE, "angle": 90.0},
    am.SingleGrid: {"omega": 1.0, "condensed": False, "stop": "error", "rtol": 0.1,
                    "max_sweeps": 2},
    am.SizeNear: {"points": ((0.0, 0.0),), "size": 1.0, "radius": 1.0, "grading": 0.3},
    am.Spring: {"boundary": "a", "normal": 1.0, "tangential": 1.0}, am.StepFile: {"path": Path("a.step"), "unit": 1.0},
    am.Support: {"boundary": "a", "x": 1.0}, am.Symmetry: {"boundary": "a"},
    am.Tied: {"slave": "a", "master": "b", "reach": 1.0}, am.Periodic: {"master": "a", "slave": "b", "jump": (1, 1)},
    am.Traction: {"boundary": "a", "components": (0.0, 1.0)},
    am.Truncated: {"recombine": 2, "coarse_solve": am.Direct(),
                   "coarse_smoother": am.ProjectedGaussSeidel()},
    am.solve: {"grids": grids, "solver": am.Multigrid(), "throw": True,
               "callback": len},
    am.solve_path: {"grids": grids, "path": am.LoadPath(), "solver": am.Multigrid(), "callback": len, "throw": True},
    am.discretise: {"problem": bar, "mesh": mesh},
    adapted: {"tolerance": 0.1, "max_nodes": 9, "max_seconds": 1.0, "indicator": am.Residual(),
              "mark": am.Doerfler(), "engine": am.Bisect(), "solver": am.FullMultigrid(), "transfer": am.L2(),
              "load_path": am.LoadPath(), "adapt_on": "last", "progress": len, "store": Path("a")},
    am.Hierarchy.uniform: {"problem": bar, "divisions": [2, 4], "diagonal": "right"},
    am.Hierarchy.graded: {"problem": bar, "sizes": [0.01], "contact_ratio": 1.0, "transfer": am.L2()},
    am.Hierarchy.from_meshes: {"problem": bar, "meshes": lambda: [mesh()], "transfer": am.L2(), "contact_rows": True},
    am.Hierarchy.single: {"discrete": discrete},
    am.Hierarchy.from_prolongations: {"discrete": discrete, "prolongations": [np.eye(3)]},
    am.Hierarchy.algebraic: {"discrete": discrete, "max_coarse": 9},
    grids().append: {"mesh": mesh}, grids().without: {"level": 1}, grids().truncated: {"coarsest": 0},
    discrete: {"law": am.Coulomb(0.3), "contact": contact(), "name": "a", "bodies": {}},
    contact: {"allow_interference": False, "names": ("a",), "masters": ("b",)},
    meshes.structured: {"domain": UNIT, "divisions": 2, "diagonal": "right"},
    meshes.graded: {"domain": UNIT, "size": 0.5, "contact_boundaries": "top", "contact_ratio": 1.0, "grading": 0.3},
    meshes.sized: {"domain": UNIT, "size_function": 0.5, "max_size": 0.5},
    meshes.as_mesh: {"mesh": mesh}, meshes.check_mesh: {"mesh": mesh}, meshes.merged: {"meshes": lambda: {"a": mesh()}},
    meshes.bisect: {"mesh": mesh, "marked": mask, "passes": 2},
    meshes.refine_near: {"mesh": mesh, "boundaries": "top", "levels": 2},
    am.Doerfler().mark: {"estimate": estimate}, am.cases.greco_block: {"plane_strain": True, "young": 1e9},
    am.Bisect().refine: {"problem": bar, "mesh": mesh, "estimate": estimate, "max_nodes": 9,
                         "marked": mask},
    am.Remesh().refine: {"problem": bar, "mesh": mesh, "estimate": estimate, "max_nodes": 9},
    **{indicator.indicate: {"hierarchy": grids, "result": lambda: am.solve(grids())}
       for indicator in (am.Residual(), am.Recovery(), am.Goal(am.ContactForce()))},
}
#: what messages say instead of the name
SAYS = {"coarsest": "", "meshes": "mesh", "sizes": "size"}


def wrong(door, value):
    yield OTHER
    kind = next((kind for kind in (bool, *WRONG) if isinstance(value, kind)), None)
    if kind is not None:
        yield from (WRONG if door in THOROUGH else FEW)[kind]
    elif not callable(value):
        yield type(value)


@pytest.mark.parametrize("door", DOORS, ids=lambda door: getattr(door, "__qualname__", "?"))
def test_each_argument_is_checked(door, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    right = {name: value() if inspect.isfunction(value) or hasattr(value, "cache_info") else value
             for name, value in DOORS[door].items()}
    for name, value in right.items():
        for other in wrong(door, value):
            with pytest.raises((TypeError, ValueError, FileNotFoundError)) as error:
                door(**right | {name: other})
            assert SAYS.get(name, name) in str(error.value), (name, other)
    assert not list(tmp_path.iterdir())


def test_every_public_class_has_its_door():
    results = {am.Certificate, am.GoalEstimate, am.MeshArrays, am.PathResult, am.Result, am.Step, am.ContactNodes,
               am.DiscreteProblem}
    public = {value for value in (getattr(am, name) for name in dir(am)) if dataclasses.is_dataclass(value)}
    assert {c for c in public - results if any(f.init for f in dataclasses.fields(c))} <= set(DOORS)
