"""The command ``adaptmg``: ``cases``, ``solve``, ``adapt``, ``study FILE.toml``, ``runs STORE``, ``report STORE``."""

from adaptmg.cli.commands import main

__all__ = ["main"]
