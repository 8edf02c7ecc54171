"""What is posed: problems, materials, laws, loads, obstacles, pairs, domains. Pure data in SI units, no NGSolve."""

from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.domains import (
    Assembly,
    Ball,
    Box,
    Common,
    Cut,
    Cylinder,
    Domain,
    Extrusion,
    Fuse,
    Moved,
    Outline,
    Polygon,
    Rectangle,
    Revolution,
    StepFile,
)
from adaptmg.problem.laws import Coulomb, Frictionless, Law, Tresca
from adaptmg.problem.load_path import LoadPath
from adaptmg.problem.load_step import step_problem
from adaptmg.problem.loads import BodyForce, InitialStrain, Pressure, Support, Traction
from adaptmg.problem.materials import Axisymmetric, Elastic, PlaneStrain, PlaneStress, Solid
from adaptmg.problem.obstacles import GapFunction, Plane
from adaptmg.problem.pairs import ContactPair

__all__ = ["Assembly", "Axisymmetric", "Ball", "BodyForce", "Box", "Common", "Contact", "ContactPair", "ContactProblem",
           "Coulomb", "Cut", "Cylinder", "Domain", "Elastic", "Extrusion", "Frictionless", "Fuse", "GapFunction",
           "InitialStrain", "Law", "LoadPath", "Moved", "Outline", "Plane", "PlaneStrain", "PlaneStress", "Polygon",
           "Pressure", "Rectangle", "Revolution", "Solid", "StepFile", "Support", "Traction", "Tresca",
           "step_problem"]
