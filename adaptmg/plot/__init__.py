"""Pictures with matplotlib: what is posed, the grids, the solution, the contact zones, the way the solver went.

Each function draws into a new figure or into given axes and returns the Figure; nothing is shown or saved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.plot.contact_zone import contact
    from adaptmg.plot.convergence import history
    from adaptmg.plot.displaced import deformation, deformed
    from adaptmg.plot.interfaces import interface
    from adaptmg.plot.load_steps import load_history
    from adaptmg.plot.meshes import grids, mesh
    from adaptmg.plot.posed import problem
    from adaptmg.plot.way import path

_WHERE = {"contact": "contact_zone", "deformation": "displaced", "deformed": "displaced", "grids": "meshes",
          "history": "convergence", "interface": "interfaces", "load_history": "load_steps", "mesh": "meshes",
          "path": "way", "problem": "posed"}

__all__ = ["contact", "deformation", "deformed", "grids", "history", "interface", "load_history", "mesh", "path",
           "problem"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        import importlib

        return getattr(importlib.import_module(f"adaptmg.plot.{_WHERE[name]}"), name)
    raise AttributeError(f"module 'adaptmg.plot' has no attribute {name!r}")
