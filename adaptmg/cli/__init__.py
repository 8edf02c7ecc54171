"""The command ``adaptmg``: ``cases``, ``solve``, ``adapt``, ``study FILE.toml``, ``runs STORE``, ``report STORE``."""

from adaptmg.cli.commands import app, main

__all__ = ["app", "main"]

#: as they are listed
_ORDER = ("cases", "solve", "adapt", "study", "runs", "report")
app.registered_commands.sort(key=lambda command: _ORDER.index(command.callback.__name__))
