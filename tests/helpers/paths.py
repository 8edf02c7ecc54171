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
    stored = am.PathResult.load(store)
    assert len(stored) == after + 1 and not stored.complete
    solved = []
    steps = am.solve_path(grids, path, solver, store=store, callback=lambda k, _: solved.append(k))
    assert steps.complete and solved == list(range(after + 1, len(path)))
    for one, other in zip(whole, steps, strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.pressures, other.pressures)
        assert (one.motions, one.cycles, one.rtol) == (other.motions, other.cycles, other.rtol)
    return steps
