"""Benchmark problems as functions that return a ContactProblem, with their reference values and sources."""

from adaptmg.cases.block import greco_block
from adaptmg.cases.curved import curved_obstacle
from adaptmg.cases.greco import greco_bar
from adaptmg.cases.registry import CASES, Case, get, names
from adaptmg.cases.upset import upset_block

__all__ = ["CASES", "Case", "curved_obstacle", "get", "greco_bar", "greco_block", "names", "upset_block"]
