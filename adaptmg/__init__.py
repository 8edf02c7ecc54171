"""adaptmg: multigrid for frictional contact on adaptively refined, non-nested meshes.

``import adaptmg as am``; names are loaded when first used, so that importing stays fast. SI units throughout.

Problem     ContactProblem; Contact or ContactPair (obstacles Plane, GapFunction); Support, Symmetry, Spring,
            PointSupport, PointSpring; Pressure, Traction, BodyForce, InitialStrain; Frictionless, Coulomb, Tresca;
            LoadPath
Material    PlaneStrain, PlaneStress, Axisymmetric, Solid
Domain      Rectangle, Circle, Polygon, Outline; Box, Ball, Cylinder, Extrusion, Revolution, StepFile; Cut, Fuse,
            Common, Moved; Assembly of several bodies; ready problems in cases, problem data in problem
Grids       Hierarchy (a Level for each grid): uniform, graded, from_meshes, ...; transfers Interpolation, PseudoL2, L2,
            LumpedL2, QuasiInterpolation; mesh, MeshArrays, SizeNear
Solve       solve, solve_path; Multigrid, FullMultigrid, SingleGrid, ActiveSet with Direct or AMG; set_threads
Ingredients Cycle, NestedStart, CoarseSolve, ProjectedGaussSeidel; corrections Truncated, Monotone, PaperCorrection;
            modules multigrid, smoother, transfer, solver
Result      Result, Status, NotConverged, Certificate, PathResult; contact states OPEN, SLIP, STICK
Adapt       adapt (each Step); indicators Residual, Recovery, Goal (of a ContactForce, Displacement,
            MeanDisplacement, Opening); marks Doerfler, Maximum; engines Remesh, Bisect; Estimate, GoalEstimate;
            module estimate
Matrices    discretise, DiscreteProblem, ContactNodes; discrete
Show        plot, export
Sweep       Study; designs and tables in study

``help(am.solve)`` shows one name with an example, ``dir(am.plot)`` lists the names of a module.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import sys
from typing import Any

__version__ = "0.1.0"

if sys.flags.optimize > 1:
    raise ImportError("adaptmg cannot run under 'python -OO' (PYTHONOPTIMIZE=2), which removes the docstrings that "
                      "pyamg and the command line read: use 'python -O'")

_SUBMODULES = ("cases", "discrete", "estimate", "export", "mesh", "multigrid", "plot", "problem", "smoother",
               "solver", "study", "transfer")

_WHERE = {
    "adaptmg._threads": ("set_threads",),
    "adaptmg.problem": ("Assembly", "Axisymmetric", "Ball", "BodyForce", "Box", "Circle", "Common", "Contact",
                        "ContactPair", "ContactProblem", "Coulomb", "Cut", "Cylinder", "Extrusion", "Frictionless",
                        "Fuse", "GapFunction", "InitialStrain", "LoadPath", "Moved", "Outline", "Plane", "PlaneStrain",
                        "PlaneStress", "PointSpring", "PointSupport", "Polygon", "Pressure", "Rectangle", "Revolution",
                        "Solid", "Spring", "StepFile", "Support", "Symmetry", "Traction", "Tresca"),
    "adaptmg.discrete.problem": ("ContactNodes", "DiscreteProblem"),
    "adaptmg.mesh": ("MeshArrays", "SizeNear"),
    "adaptmg.discrete.discretise": ("discretise",),
    "adaptmg.transfer": ("Interpolation", "L2", "LumpedL2", "PseudoL2", "QuasiInterpolation"),
    "adaptmg.hierarchy": ("Hierarchy", "Level"),
    "adaptmg.smoother.gauss_seidel": ("ProjectedGaussSeidel",),
    "adaptmg.smoother.system": ("OPEN", "SLIP", "STICK"),
    "adaptmg.multigrid": ("CoarseSolve", "Cycle", "Monotone", "NestedStart", "PaperCorrection"),
    "adaptmg.solver.single_grid": ("SingleGrid",),
    "adaptmg.solver.multigrid": ("FullMultigrid", "Multigrid"),
    "adaptmg.solver.truncated": ("Truncated",),
    "adaptmg.solver.active_set": ("ActiveSet",),
    "adaptmg.solver.linear": ("AMG", "Direct"),
    "adaptmg.solver.solve": ("solve",),
    "adaptmg.solver.load_path": ("PathResult", "solve_path"),
    "adaptmg.solver.certificate": ("Certificate",),
    "adaptmg.solver.result": ("NotConverged", "Result"),
    "adaptmg.solver.record": ("Status",),
    "adaptmg.estimate.bisect": ("Bisect",),
    "adaptmg.estimate.estimate": ("Doerfler", "Estimate", "Maximum"),
    "adaptmg.estimate.adapt": ("adapt",),
    "adaptmg.estimate.step": ("Step",),
    "adaptmg.estimate.remesh": ("Remesh",),
    "adaptmg.estimate.goal": ("Goal", "GoalEstimate"),
    "adaptmg.estimate.quantities": ("ContactForce", "Displacement", "MeanDisplacement", "Opening"),
    "adaptmg.estimate.recovery": ("Recovery",),
    "adaptmg.estimate.residual": ("Residual",),
    "adaptmg.study.study": ("Study",),
}
_HOME = {name: module for module, names in _WHERE.items() for name in names}

#: not __all__, with which help(adaptmg) would show each class at length
_NAMES = sorted([*_HOME, *_SUBMODULES, "__version__"])


def _naming_arguments(kind: Any) -> None:
    """Make calls that a class refuses name its arguments, which Python does not do."""
    made = kind.__init__

    @functools.wraps(made)
    def __init__(self: object, *arguments: object, **named: object) -> None:
        try:
            made(self, *arguments, **named)
        except TypeError as error:
            if error.__traceback__ is not None and error.__traceback__.tb_next is None:  # not from within the call
                taken = str(inspect.signature(kind)).replace("'", "").removesuffix(" -> None")
                error.add_note(f"am.{kind.__name__}{taken}")
            raise

    kind.__init__ = __init__


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(_HOME[name]), name)
        if "__dataclass_fields__" in vars(value):
            _naming_arguments(value)
        globals()[name] = value
        return value
    if name in _SUBMODULES:
        return importlib.import_module(f"adaptmg.{name}")
    raise AttributeError(f"module 'adaptmg' has no attribute {name!r}")


def __dir__() -> list[str]:
    return _NAMES
