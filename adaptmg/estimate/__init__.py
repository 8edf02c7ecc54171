"""Where the discretisation errs: indicators, what is marked, and the loop solve - estimate - mark - refine."""

from __future__ import annotations

from adaptmg.estimate.estimate import Doerfler, Estimate, Maximum
from adaptmg.estimate.recovery import Recovery
from adaptmg.estimate.reference_error import EnergyError, Reference, energy_error
from adaptmg.estimate.remesh import Remesh
from adaptmg.estimate.residual import Residual
from adaptmg.estimate.stress_fields import BoundaryTractions, boundary_tractions

__all__ = ["BoundaryTractions", "Doerfler", "EnergyError", "Estimate", "Maximum", "Recovery", "Reference", "Remesh",
           "Residual", "boundary_tractions", "energy_error"]


def __dir__() -> list[str]:
    return __all__
