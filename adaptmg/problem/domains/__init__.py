"""Domains as pure data: plane ones, boxes, solids from primitives and their combinations or STEP files, assemblies."""

from adaptmg.problem.domains.combined import Assembly, Combination, Common, Cut, Fuse, Moved
from adaptmg.problem.domains.outlines import Outline
from adaptmg.problem.domains.primitives import Ball, Cylinder, Extrusion, Revolution, SolidDomain
from adaptmg.problem.domains.step_file import StepFile
from adaptmg.problem.domains.straight import Box, Domain, Polygon, Rectangle

__all__ = ["Assembly", "Ball", "Box", "Combination", "Common", "Cut", "Cylinder", "Domain", "Extrusion", "Fuse",
           "Moved", "Outline", "Polygon", "Rectangle", "Revolution", "SolidDomain", "StepFile"]
