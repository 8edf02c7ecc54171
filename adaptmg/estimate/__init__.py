"""Where the discretisation errs: indicators, what is marked, and the loop solve - estimate - mark - refine."""

from __future__ import annotations

from adaptmg.estimate.estimate import Estimate

__all__ = ["Estimate"]
