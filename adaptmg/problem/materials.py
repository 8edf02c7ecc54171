r"""Linear elastic, isotropic materials.

The stress is :math:`\sigma = \lambda\,\mathrm{tr}(\varepsilon) I + 2\mu\,\varepsilon` with
:math:`\mu = E / (2(1+\nu))` and :math:`\lambda = E\nu / ((1+\nu)(1-2\nu))` in three dimensions and in plane strain;
plane stress has :math:`\lambda = E\nu / (1-\nu^2)`. Axisymmetric bodies have, besides the strains of the meridian plane
(r, z), the hoop strain :math:`\varepsilon_{\theta\theta} = u_r / r`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from adaptmg import _checks as checks

_FROM_LIMIT = 1e-9  # closer to its limits, one modulus is of the size of rounding of the other


@dataclass(frozen=True, kw_only=True)
class Elastic:
    """Isotropic linear elasticity; use one of the subclasses.

    ``young`` is Young's modulus, Pa, > 0, ``poisson`` Poisson's ratio in (-1, 0.5). Strains are to be small (a few per
    cent). Above 0.45 linear elements lock, but in plane stress: they are too stiff, and stresses oscillate.
    """

    young: float
    poisson: float
    dim: ClassVar[int]

    def __post_init__(self) -> None:
        checks.convert(self, checks.quantity, "young", positive=True)
        checks.convert(self, checks.number, "poisson")
        if not -1 + _FROM_LIMIT < self.poisson < 0.5 - _FROM_LIMIT:
            raise ValueError(f"poisson must lie between -1 and 0.5 (both excluded, and by more than {_FROM_LIMIT:g}), "
                             f"got {self.poisson!r}")

    @property
    def shear_modulus(self) -> float:
        """Second Lame constant mu, Pa."""
        return self.young / (2 * (1 + self.poisson))

    @property
    def lame(self) -> float:
        """First Lame constant lambda as it enters the stress, Pa."""
        return self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))


@dataclass(frozen=True, kw_only=True)
class PlaneStrain(Elastic):
    """Plane strain: a long body, strain only in the plane. Forces are per metre of length.

    Examples
    --------
    >>> am.PlaneStrain(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 2


@dataclass(frozen=True, kw_only=True)
class PlaneStress(Elastic):
    """Plane stress: a thin sheet. Forces are per metre of thickness.

    Examples
    --------
    >>> am.PlaneStress(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 2

    @property
    def lame(self) -> float:
        """First Lame constant of plane stress, Pa."""
        return self.young * self.poisson / (1 - self.poisson**2)


@dataclass(frozen=True, kw_only=True)
class Axisymmetric(Elastic):
    """A body of revolution without torsion: x is the radius r >= 0, y the axial coordinate z.

    All forces are those over the full circumference, N: integrals are weighted with 2 pi r.

    Examples
    --------
    >>> am.Axisymmetric(young=2.1e11, poisson=0.3).poisson
    0.3
    """

    dim: ClassVar[int] = 2


@dataclass(frozen=True, kw_only=True)
class Solid(Elastic):
    """A three-dimensional body.

    Examples
    --------
    >>> am.Solid(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 3
