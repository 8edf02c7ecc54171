"""Pictures with matplotlib: problems, grids, solutions, contact surfaces, cycle diagrams, histories, adaptive loops.

Each function draws into a new figure or into the given axes and returns the Figure; nothing is saved. Notebooks show
it. pyplot does not keep it: in a script ``plt.figure(figure)`` (matplotlib 3.11) gives it to pyplot for ``plt.show()``.
Names of problems, bodies and boundaries are shown unchanged; labels given to a function may hold math text.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from adaptmg.plot.contact_surfaces import contact
    from adaptmg.plot.convergence import history, path
    from adaptmg.plot.deformed import deformation
    from adaptmg.plot.load_histories import load_history
    from adaptmg.plot.meshes import adaptation, grids, mesh
    from adaptmg.plot.posed_problem import problem

_WHERE = {"adaptation": "meshes", "contact": "contact_surfaces", "deformation": "deformed", "grids": "meshes",
          "history": "convergence", "load_history": "load_histories", "mesh": "meshes", "path": "convergence",
          "problem": "posed_problem"}

__all__ = ["adaptation", "contact", "deformation", "grids", "history", "load_history", "mesh", "path", "problem"]


def __getattr__(name: str) -> object:
    if name in _WHERE:
        import importlib

        return getattr(importlib.import_module(f"adaptmg.plot.{_WHERE[name]}"), name)
    raise AttributeError(f"module 'adaptmg.plot' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
