"""Pictures with matplotlib: problems, grids, solutions, contact surfaces, cycle diagrams, histories, adaptive loops.

Each function draws into a new figure or into the given axes and returns the Figure; nothing is saved. Notebooks show
it. pyplot does not keep it: in a script ``plt.figure(figure)`` (matplotlib 3.11) gives it to pyplot for ``plt.show()``.
Names of problems, bodies and boundaries are shown unchanged; labels given to a function may hold math text.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptmg._lazy import lazily

if TYPE_CHECKING:
    from adaptmg.plot.contact_surfaces import contact
    from adaptmg.plot.convergence import history, path
    from adaptmg.plot.deformed import deformation
    from adaptmg.plot.load_histories import load_history
    from adaptmg.plot.meshes import adaptation, grids, mesh
    from adaptmg.plot.posed_problem import problem

__all__ = ["adaptation", "contact", "deformation", "grids", "history", "load_history", "mesh", "path", "problem"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = lazily(__name__, {
        "contact_surfaces": "contact", "convergence": "history path", "deformed": "deformation",
        "load_histories": "load_history", "meshes": "adaptation grids mesh", "posed_problem": "problem"})
