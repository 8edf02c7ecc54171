"""Load paths that stop, and go on from their store."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import adaptmg as am


def resumed(
    grids: am.Hierarchy, path: am.LoadPath, solver: object, store: Path, after: int
) -> am.PathResult:
    """Return the steps of a path that stops after step ``after`` and goes on from its store; check
    that they have the bits of a path that does not stop."""
    whole = am.solve_path(grids, path, solver)
    with pytest.raises(ZeroDivisionError):
        am.solve_path(grids, path, solver, store=store, callback=lambda k, _: 1 / (after - k))
    steps = am.solve_path(grids, path, solver, store=store)
    for one, other in zip(whole, steps, strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
    return steps
