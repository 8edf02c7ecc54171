"""The command ``adaptmg``: ``cases``, ``solve``, ``adapt``, ``study FILE.py``, ``report STORE``,
``warm``."""

from adaptmg.cli.commands import main

__all__ = ["main"]
