"""adaptmg: multigrid for frictional contact on adaptively refined, non-nested meshes.

``import adaptmg as am``; names are loaded when first used, so that importing stays fast. SI units
throughout.

Problem     ContactProblem; Contact, ContactPair, Tied, Periodic (obstacles Plane, GapFunction,
            Moving, Rigid); Support, Symmetry, Spring, PointSupport, PointSpring; Pressure, Traction, BodyForce,
            PointForce, InitialStrain, Preload; Frictionless, Coulomb, Tresca, StateLaw;
            NormalCompliance; LoadPath, Dynamics
Material    PlaneStrain, PlaneStress, Axisymmetric, Solid; Plastic
Domain      Rectangle, Circle, Polygon, Outline, Cracked; Box, Ball, Cylinder, Extrusion, Revolution, StepFile; Cut,
            Fuse, Common, Moved; Assembly of several bodies; ready problems in cases, problem data
            in problem
Grids       Hierarchy (a Level for each grid, a Forecast of costs): uniform, graded, from_meshes, ...; transfers
            Interpolation, PseudoL2, L2, LumpedL2, QuasiInterpolation; mesh, MeshArrays, SizeNear
Solve       solve, solve_path (transfer_state), march (impact); Multigrid, FullMultigrid, SingleGrid, ActiveSet with
            Direct or AMG; set_threads
Ingredients State (a step of yours), PyAMG, Cycle, NestedStart, CoarseSolve, ProjectedGaussSeidel;
            corrections Truncated, Monotone, PaperCorrection; modules multigrid, smoother, transfer,
            solver
Result      Result, Status, NotConverged, Certificate, PathResult; contact states OPEN, SLIP, STICK
Adapt       adapt (each Step); indicators Residual, Recovery, Goal (of a ContactForce, Displacement,
            MeanDisplacement, Opening, PeakPressure, Dissipation); marks Doerfler, Maximum; engines Remesh, Bisect;
            Estimate, GoalEstimate; module estimate
Matrices    discretise, DiscreteProblem, ContactNodes, Bounds; ScalarProblem; discrete
Show        plot, export; set_units
Sweep       Study; designs and tables in study

``help(am.solve)`` shows one name with an example, ``dir(am.plot)`` lists the names of a module.
"""

import functools
import os
from typing import Any

import lazy_loader

#: times of the sources when they were loaded: files of other times are not those that run
_LOADED = {
    os.path.join(folder, name): os.stat(os.path.join(folder, name)).st_mtime_ns
    for folder, _, names in os.walk(os.path.dirname(__file__))
    for name in names
    if name.endswith(".py")
}

# the names stand in __init__.pyi; not __all__, with which help(adaptmg) would show each class at
# length
_load, __dir__, _ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("adaptmg")
        except PackageNotFoundError:  # a source tree that is not installed
            return "unknown"
    value = _load(name)
    if "__dataclass_fields__" in vars(value):
        _naming_arguments(value)
    return value


def _naming_arguments(kind: Any) -> None:
    """Add the signature of a class to the TypeErrors of calls with wrong arguments."""
    constructor = kind.__init__

    @functools.wraps(constructor)
    def __init__(self: object, *arguments: object, **named: object) -> None:
        try:
            constructor(self, *arguments, **named)
        except TypeError as error:
            # no further frame: the arguments do not fit, and the constructor has not begun
            in_call_itself = error.__traceback__ is not None and error.__traceback__.tb_next is None
            if in_call_itself:
                import inspect

                signature = inspect.signature(kind)
                names = [
                    parameter.replace(annotation=parameter.empty)
                    for parameter in signature.parameters.values()
                ]
                signature = signature.replace(parameters=names, return_annotation=signature.empty)
                error.add_note(f"am.{kind.__name__}{signature}")
            raise

    kind.__init__ = __init__
