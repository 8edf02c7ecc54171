"""HertzContact: what the closed forms of Hertz for line and point contact share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from adaptmg.problem import checks

__all__ = ["HertzContact"]


@dataclass(frozen=True, kw_only=True)
class HertzContact(ABC):
    """A pressure that falls like half an ellipse from the middle of contact.

    Parameters
    ----------
    load : float
        P, > 0: N/m in line contact, N in point contact.
    radius : float
        R, of the relative curvature, m, > 0.
    modulus : float
        The contact modulus E*, Pa, > 0.
    """

    load: float
    radius: float
    modulus: float

    def __post_init__(self) -> None:
        for name in ("load", "radius", "modulus"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))

    @property
    @abstractmethod
    def half_width(self) -> float:
        """a, half the width or the radius of contact, m."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """p0, Pa."""

    def pressure(self, distance: np.ndarray) -> np.ndarray:
        """Pressure at distances from the middle (m), Pa."""
        return self.peak * np.sqrt(np.maximum(0.0, 1 - (np.asarray(distance) / self.half_width)**2))
