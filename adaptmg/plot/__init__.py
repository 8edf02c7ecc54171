"""Pictures with matplotlib: problems, grids, solutions, contact surfaces, cycle diagrams,
histories, adaptive loops.

Each function draws into a new figure or into the given axes and returns the Figure; nothing is
saved. Notebooks show it. pyplot does not keep it: in a script ``plt.figure(figure)`` (matplotlib
3.11) gives it to pyplot for ``plt.show()``. Names of problems, bodies and boundaries are shown
unchanged; labels given to a function may hold math text."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
