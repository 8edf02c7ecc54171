"""The command ``adaptmg``: ``cases``, ``solve``, ``adapt``, ``study FILE.toml``, ``runs STORE``, ``report STORE``."""

from adaptmg.cli import report, runs, study  # each adds its command
from adaptmg.cli.command import app, main

__all__ = ["app", "main", "report", "runs", "study"]
