"""Where the discretisation errs: indicators, what is marked, and the loop solve - estimate - mark - refine."""

from __future__ import annotations

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.marking import Doerfler, Maximum
from adaptmg.estimate.recovery import Recovery
from adaptmg.estimate.residual import Residual

__all__ = ["Doerfler", "Estimate", "Maximum", "Recovery", "Residual"]
