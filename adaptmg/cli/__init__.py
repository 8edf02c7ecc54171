"""The command ``adaptmg``: ``cases``, ``solve``, ``adapt``, ``study FILE.toml``, ``runs STORE``, ``report STORE``."""

from adaptmg.cli.commands import app, main

__all__ = ["app", "main"]
