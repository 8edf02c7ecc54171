"""Indicators of the error of the discretisation, marking, and the loop solve - estimate - mark -
refine."""

from __future__ import annotations

from adaptmg.estimate.engines import Remesh
from adaptmg.estimate.estimate import Doerfler, Estimate, Maximum, Recovery, Residual
from adaptmg.estimate.reference_error import EnergyError, Reference, energy_error

__all__ = [
    "Doerfler",
    "EnergyError",
    "Estimate",
    "Maximum",
    "Recovery",
    "Reference",
    "Remesh",
    "Residual",
    "energy_error",
]


def __dir__() -> list[str]:
    return __all__
