"""The public names, loaded when first used; this list is the one that lazy_loader reads."""

from . import (
    cases as cases,
    discrete as discrete,
    estimate as estimate,
    export as export,
    mesh as mesh,
    multigrid as multigrid,
    plot as plot,
    problem as problem,
    smoother as smoother,
    solver as solver,
    study as study,
    transfer as transfer,
)
from ._threads import set_threads as set_threads
from ._units import set_units as set_units
from .discrete.discretise import discretise as discretise
from .discrete.contact_nodes import Bounds as Bounds
from .discrete.problem import ContactNodes as ContactNodes, DiscreteProblem as DiscreteProblem
from .discrete.scalar import ScalarProblem as ScalarProblem
from .estimate.adapt import adapt as adapt
from .estimate.engines import Bisect as Bisect, Remesh as Remesh
from .estimate.estimate import (
    Doerfler as Doerfler,
    Estimate as Estimate,
    Maximum as Maximum,
    Recovery as Recovery,
    Residual as Residual,
)
from .estimate.goal import Goal as Goal, GoalEstimate as GoalEstimate
from .estimate.quantities import (
    ContactForce as ContactForce,
    Displacement as Displacement,
    Dissipation as Dissipation,
    MeanDisplacement as MeanDisplacement,
    Opening as Opening,
    PeakPressure as PeakPressure,
)
from .estimate.loop import Step as Step
from .evolution.march import march as march
from .hierarchy import Forecast as Forecast, Hierarchy as Hierarchy
from .level import Level as Level
from .mesh import MeshArrays as MeshArrays, SizeNear as SizeNear
from .multigrid import (
    CoarseSolve as CoarseSolve,
    Cycle as Cycle,
    Monotone as Monotone,
    NestedStart as NestedStart,
    PaperCorrection as PaperCorrection,
    PyAMG as PyAMG,
)
from .multigrid.truncated_parts import Truncated as Truncated
from .problem import (
    Assembly as Assembly,
    Axisymmetric as Axisymmetric,
    Ball as Ball,
    BodyForce as BodyForce,
    Box as Box,
    Circle as Circle,
    Common as Common,
    Contact as Contact,
    ContactPair as ContactPair,
    ContactProblem as ContactProblem,
    Coulomb as Coulomb,
    Cracked as Cracked,
    Cut as Cut,
    Cylinder as Cylinder,
    Dynamics as Dynamics,
    Extrusion as Extrusion,
    Frictionless as Frictionless,
    Fuse as Fuse,
    GapFunction as GapFunction,
    InitialStrain as InitialStrain,
    LoadPath as LoadPath,
    Moved as Moved,
    Moving as Moving,
    NormalCompliance as NormalCompliance,
    Outline as Outline,
    Periodic as Periodic,
    Plane as Plane,
    PlaneStrain as PlaneStrain,
    PlaneStress as PlaneStress,
    Plastic as Plastic,
    PointForce as PointForce,
    PointSpring as PointSpring,
    PointSupport as PointSupport,
    Polygon as Polygon,
    Preload as Preload,
    Pressure as Pressure,
    Rectangle as Rectangle,
    Revolution as Revolution,
    Rigid as Rigid,
    Solid as Solid,
    Spring as Spring,
    StateLaw as StateLaw,
    StepFile as StepFile,
    Support as Support,
    Symmetry as Symmetry,
    Tied as Tied,
    Traction as Traction,
    Tresca as Tresca,
)
from .smoother.gauss_seidel import ProjectedGaussSeidel as ProjectedGaussSeidel
from .smoother.system import OPEN as OPEN, SLIP as SLIP, STICK as STICK
from .solver.active_set import ActiveSet as ActiveSet
from .solver.certificate import Certificate as Certificate
from .smoother.linear import AMG as AMG, Direct as Direct
from .evolution.load_path import PathResult as PathResult, solve_path as solve_path
from .evolution.state_transfer import transfer_state as transfer_state
from .solver.multigrid import FullMultigrid as FullMultigrid, Multigrid as Multigrid
from .solver.projected import SingleGrid as SingleGrid
from .solver.record import Status as Status
from .solver.result import NotConverged as NotConverged, Result as Result
from .solver.iterate import State as State
from .solver.solve import solve as solve
from .study.study import Study as Study
from .transfer import (
    Interpolation as Interpolation,
    L2 as L2,
    LumpedL2 as LumpedL2,
    PseudoL2 as PseudoL2,
    QuasiInterpolation as QuasiInterpolation,
)

__version__: str
