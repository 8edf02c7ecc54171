"""The command ``adaptmg``: ``adaptmg cases``, ``adaptmg solve CASE``, ``adaptmg adapt CASE``."""

from adaptmg.cli.command import app, main

__all__ = ["app", "main"]
