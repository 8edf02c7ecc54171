"""The command ``adaptmg``: ``cases``, ``solve CASE``, ``adapt CASE``, ``study FILE.toml``, ``runs STORE``."""

from adaptmg.cli import runs, study  # each adds its command
from adaptmg.cli.command import app, main

__all__ = ["app", "main", "runs", "study"]
