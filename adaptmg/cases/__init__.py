"""Benchmark problems as functions that return a ContactProblem, with their reference values and sources."""

from adaptmg.cases.block import greco_block
from adaptmg.cases.bolted_junction import bolted_junction
from adaptmg.cases.bolted_measures import bolt_force, joint_opening, junction_path, open_to, sealing_pressure
from adaptmg.cases.cattaneo import PartialSlip, cattaneo, cattaneo_path
from adaptmg.cases.coulomb_field import TransitionField
from adaptmg.cases.coulomb_transition import coulomb_transition
from adaptmg.cases.curved import curved_obstacle
from adaptmg.cases.dovetail import dovetail
from adaptmg.cases.flanges import Flanges
from adaptmg.cases.flat_punch import PunchPressure, flat_punch, flat_punch_meshes
from adaptmg.cases.greco import greco_bar
from adaptmg.cases.hertz_cylinder import LineContact, hertz_cylinder, line_contact_meshes, pressure_fit
from adaptmg.cases.hertz_sphere import PointContact, hertz_sphere
from adaptmg.cases.incline import incline
from adaptmg.cases.leaning_strut import leaning_strut
from adaptmg.cases.registry import CASES, Case, get, names
from adaptmg.cases.two_blocks import patch_mesh, two_block_patch
from adaptmg.cases.upset import upset_block

__all__ = ["CASES", "Case", "Flanges", "LineContact", "PartialSlip", "PointContact", "PunchPressure",
           "TransitionField", "bolt_force", "bolted_junction", "cattaneo", "cattaneo_path", "coulomb_transition",
           "curved_obstacle", "dovetail", "flat_punch", "flat_punch_meshes", "get", "greco_bar", "greco_block",
           "hertz_cylinder", "hertz_sphere", "incline", "joint_opening", "junction_path", "leaning_strut",
           "line_contact_meshes", "names", "open_to", "patch_mesh", "pressure_fit", "sealing_pressure",
           "two_block_patch", "upset_block"]
