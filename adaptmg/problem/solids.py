"""Solids: bodies in space as pure data, from primitives and their combinations, or from STEP files."""

from adaptmg.problem.combined import Combination, Common, Cut, Fuse, Moved
from adaptmg.problem.primitives import Ball, Cylinder, Extrusion, Revolution, SolidDomain
from adaptmg.problem.step_file import StepFile

__all__ = ["Ball", "Combination", "Common", "Cut", "Cylinder", "Extrusion", "Fuse", "Moved", "Revolution",
           "SolidDomain", "StepFile"]
