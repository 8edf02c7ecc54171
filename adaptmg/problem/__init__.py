"""Problems: materials, laws, loads, obstacles, pairs and domains as pure data in SI units, without
NGSolve."""

from adaptmg.problem.combined_domains import Assembly, Common, Cracked, Cut, Fuse
from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.dynamics import Dynamics
from adaptmg.problem.laws import (
    Axisymmetric,
    Coulomb,
    Elastic,
    Frictionless,
    Law,
    NormalCompliance,
    PlaneStrain,
    PlaneStress,
    Solid,
    StateLaw,
    Tresca,
)
from adaptmg.problem.load_path import LoadPath, step_problem
from adaptmg.problem.loads import (
    BodyForce,
    InitialStrain,
    PointForce,
    PointSpring,
    PointSupport,
    Preload,
    Pressure,
    Spring,
    Support,
    Symmetry,
    Traction,
)
from adaptmg.problem.plane_domains import Box, Circle, Domain, Outline, Polygon, Rectangle
from adaptmg.problem.plastic import Inelastic, Plastic
from adaptmg.problem.solid_domains import Ball, Cylinder, Extrusion, Moved, Revolution, StepFile
from adaptmg.problem.surfaces import ContactPair, GapFunction, Moving, Periodic, Plane, Rigid, Tied

__all__ = [
    "Assembly",
    "Axisymmetric",
    "Ball",
    "BodyForce",
    "Box",
    "Circle",
    "Common",
    "Contact",
    "ContactPair",
    "ContactProblem",
    "Coulomb",
    "Cracked",
    "Cut",
    "Cylinder",
    "Domain",
    "Dynamics",
    "Elastic",
    "Extrusion",
    "Frictionless",
    "Fuse",
    "GapFunction",
    "Inelastic",
    "InitialStrain",
    "Law",
    "LoadPath",
    "Moved",
    "Moving",
    "NormalCompliance",
    "Outline",
    "Periodic",
    "Plane",
    "PlaneStrain",
    "PlaneStress",
    "Plastic",
    "PointForce",
    "PointSpring",
    "PointSupport",
    "Polygon",
    "Preload",
    "Pressure",
    "Rectangle",
    "Revolution",
    "Rigid",
    "Solid",
    "Spring",
    "StateLaw",
    "StepFile",
    "Support",
    "Symmetry",
    "Tied",
    "Traction",
    "Tresca",
    "step_problem",
]


def __dir__() -> list[str]:
    return __all__
