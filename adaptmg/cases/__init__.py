"""Benchmark problems as functions that return a ContactProblem, with their reference values and sources."""

from adaptmg.cases.block import greco_block
from adaptmg.cases.cattaneo import PartialSlip, cattaneo, cattaneo_path
from adaptmg.cases.curved import curved_obstacle
from adaptmg.cases.dovetail import dovetail
from adaptmg.cases.flat_punch import PunchPressure, flat_punch, flat_punch_meshes
from adaptmg.cases.greco import greco_bar
from adaptmg.cases.hertz_cylinder import LineContact, hertz_cylinder, line_contact_meshes, pressure_fit
from adaptmg.cases.hertz_sphere import PointContact, hertz_sphere
from adaptmg.cases.incline import incline
from adaptmg.cases.registry import CASES, Case, get, names
from adaptmg.cases.two_blocks import patch_mesh, two_block_patch
from adaptmg.cases.upset import upset_block

__all__ = ["CASES", "Case", "LineContact", "PartialSlip", "PointContact", "PunchPressure", "cattaneo", "cattaneo_path",
           "curved_obstacle", "dovetail", "flat_punch", "flat_punch_meshes", "get", "greco_bar", "greco_block",
           "hertz_cylinder", "hertz_sphere", "incline", "line_contact_meshes", "names", "patch_mesh", "pressure_fit",
           "two_block_patch", "upset_block"]
