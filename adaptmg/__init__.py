"""adaptmg: multigrid for frictional contact on adaptively refined, non-nested meshes.

``import adaptmg as am``; names are loaded when first used, so that importing stays fast.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

from adaptmg.runtime import kernel_cache

__version__ = "0.1.0"

if sys.flags.optimize > 1:
    raise ImportError("adaptmg cannot run under 'python -OO' (PYTHONOPTIMIZE=2), which removes the docstrings that "
                      "pyamg and the command line read: use 'python -O'")

kernel_cache.install()

_SUBMODULES = ("cases", "discretisation", "estimate", "export", "mesh", "multigrid", "plot", "problem", "smoother",
               "solver", "study", "transfer")

_WHERE = {
    "adaptmg.problem": ("Assembly", "Axisymmetric", "BodyForce", "Box", "Contact", "ContactPair", "ContactProblem",
                        "Coulomb", "Frictionless", "GapFunction", "InitialStrain", "LoadPath", "Outline", "Plane",
                        "PlaneStrain", "PlaneStress", "Polygon", "Pressure", "Rectangle", "Solid", "Support",
                        "Traction", "Tresca"),
    "adaptmg.problem.domains": ("Ball", "Common", "Cut", "Cylinder", "Extrusion", "Fuse", "Moved", "Revolution",
                               "StepFile"),
    "adaptmg.discrete": ("ContactNodes", "DiscreteProblem"),
    "adaptmg.mesh": ("MeshArrays", "SizeNear"),
    "adaptmg.discretisation.discretise": ("discretise",),
    "adaptmg.transfer": ("Interpolation", "L2", "LumpedL2", "PseudoL2", "QuasiInterpolation"),
    "adaptmg.hierarchy": ("Hierarchy", "Level"),
    "adaptmg.smoother.gauss_seidel": ("ProjectedGaussSeidel",),
    "adaptmg.smoother.state": ("OPEN", "SLIP", "STICK"),
    "adaptmg.multigrid": ("CoarseSolve", "Cycle", "Monotone", "NestedStart", "PaperCorrection"),
    "adaptmg.solver.single_grid": ("SingleGrid",),
    "adaptmg.solver.multigrid": ("FullMultigrid", "Multigrid"),
    "adaptmg.solver.truncated.options": ("Truncated",),
    "adaptmg.solver.newton.active_set": ("ActiveSet",),
    "adaptmg.solver.linear": ("AMG", "Direct"),
    "adaptmg.solver.solve": ("solve",),
    "adaptmg.solver.history.load_path": ("PathResult", "solve_path"),
    "adaptmg.solver.certificate": ("Certificate",),
    "adaptmg.solver.result": ("Result",),
    "adaptmg.solver.result.not_converged": ("NotConverged",),
    "adaptmg.solver.result.status": ("Status",),
    "adaptmg.estimate.bisect_engine": ("Bisect",),
    "adaptmg.estimate.estimate": ("Estimate",),
    "adaptmg.estimate.loop.adapt": ("adapt",),
    "adaptmg.estimate.loop.step": ("Step",),
    "adaptmg.estimate.remesh_engine": ("Remesh",),
    "adaptmg.estimate.goals": ("ContactForce", "Displacement", "Goal", "GoalEstimate", "MeanDisplacement", "Opening"),
    "adaptmg.estimate.marking": ("Doerfler", "Maximum"),
    "adaptmg.estimate.recovery": ("Recovery",),
    "adaptmg.estimate.residual": ("Residual",),
    "adaptmg.study.study": ("Study",),
}
_HOME = {name: module for module, names in _WHERE.items() for name in names}

__all__ = sorted([*_HOME, *_SUBMODULES, "__version__"])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    if name in _SUBMODULES:
        return importlib.import_module(f"adaptmg.{name}")
    raise AttributeError(f"module 'adaptmg' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
