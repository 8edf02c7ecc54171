r"""Plastic materials: the von Mises yield condition with hardening, and the protocol of others.

With the elastic strain :math:`\varepsilon - \varepsilon_p`, its stress and the deviator s of that
stress yield ends where

.. math:: \sqrt{\tfrac32}\,|s - \beta| \le \sigma_y(\alpha),\qquad \dot\varepsilon_p =
   \sqrt{\tfrac32}\,\dot\alpha\, n,\quad n = \frac{s - \beta}{|s - \beta|},\quad
   \beta = \tfrac23 H_k\,\varepsilon_p

with the accumulated plastic strain :math:`\alpha`, on which the yield stress depends (isotropic
hardening), and the back stress :math:`\beta` (linear kinematic hardening). A step of the load is an
implicit Euler step, the radial return (J. C. Simo and R. L. Taylor, Comput. Methods Appl. Mech.
Engng 48, 1985, doi:10.1016/0045-7825(85)90070-2): of the stress :math:`s^*` that no further yield
would leave, with :math:`\xi = s^* - \beta`,

.. math:: (3 G + H_k)\,\Delta\alpha + \sigma_y(\alpha + \Delta\alpha) = \sqrt{\tfrac32}\,|\xi|,
   \qquad s = s^* - 2 G \sqrt{\tfrac32}\,\Delta\alpha\, n .

Its derivative, the consistent tangent, is with :math:`\vartheta = 1 - 2 G
\sqrt{3/2}\,\Delta\alpha / |\xi|`

.. math:: C = K\, m m^T + 2 G\,(\vartheta\, I_\mathrm{dev} - \bar\vartheta\, n n^T),\qquad
   \bar\vartheta = \frac{1}{1 + (H + H_k) / 3 G} - (1 - \vartheta) .
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Protocol, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._checks import Size
from adaptmg._text import html_fields
from adaptmg.problem.laws import Elastic, PlaneStress

#: of three shear moduli: hardening that a tangent has at least; without any the diagonal block of a node whose
#: surroundings all flow is singular
_SOFTEST = 1e-8


class Inelastic(Protocol):
    """The protocol of a material whose stress depends on its history; :class:`Plastic` has it.

    Strains and stresses have the columns xx, yy, zz, xy (in space yz and xz too; axisymmetric rr,
    zz, hoop, rz); shear strains are angles, twice the components of the tensor."""

    @property
    def elastic(self) -> Elastic:
        """Return the isotropic elastic part, with which a body begins."""
        ...

    @property
    def state_size(self) -> int:
        """Return how many numbers a state has; all are 0 in the beginning."""
        ...

    def response(
        self, strain: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stresses (n, k), Pa, their derivatives by the strains (n, k, k), symmetric,
        and the states (n, state_size) of n patches with strains (n, k) after a load step that
        began with ``state`` (n, state_size). The arrays must not be changed."""
        ...


def _hardening(name: str, value: float | Sequence[Sequence[float]]) -> float | tuple:
    """Return a slope of hardening, or a table of strains and yield stresses, checked."""
    if not np.ndim(value):
        return checks.nonnegative(name, value)
    table = checks.array(name, value, (None, 2))
    if table[0, 0] or not (np.diff(table[:, 0]) > 0).all() or not (np.diff(table[:, 1]) >= 0).all():
        raise ValueError(
            f"{name} must be a number, or rows (plastic strain, yield stress) from strain 0 on with "
            f"rising strains and yield stresses that do not fall, got {checks.shown(value)}"
        )
    return tuple(map(tuple, table.tolist()))


@dataclass(frozen=True, eq=False, repr=False)
class Plastic(checks.Checked):
    """A material that yields under the von Mises stress, with isotropic and kinematic hardening.

    Parameters
    ----------
    elastic : PlaneStrain, Axisymmetric or Solid
        Isotropic, with Poisson's ratio below .5.
    yield_stress : float
        In uniaxial tension, Pa.
    hardening : float or sequence of (float, float)
        Rise of the yield stress over the accumulated plastic strain, Pa, >= 0; or a table of that
        strain and the yield stress, Pa, from (0, yield_stress) on, linear between its rows and
        constant after the last.
    kinematic : float
        Rise of the stress at which the yield surface has its centre, over the plastic strain, in
        uniaxial tension, Pa, >= 0.

    Notes
    -----
    A state has the plastic strain in k columns as of :class:`~adaptmg.problem.plastic.Inelastic`
    and the accumulated plastic strain.

    Examples
    --------
    >>> steel = am.Plastic(am.PlaneStrain(young=2.1e11, poisson=0.3), yield_stress=3e8, hardening=1e9)
    >>> stress, tangent, state = steel.response(np.array([[0.004, 0.0, 0.0, 0.0]]), np.zeros((1, 5)))
    >>> stress.round(-6).tolist()
    [[901000000.0, 600000000.0, 600000000.0, 0.0]]
    """

    elastic: Annotated[Elastic, partial(checks.instance, types=Elastic)]
    yield_stress: Size
    hardening: Annotated[float | Sequence[Sequence[float]], _hardening] = 0.0
    kinematic: Annotated[float, checks.nonnegative] = 0.0

    _repr_html_ = html_fields

    def __post_init__(self) -> None:
        super().__post_init__()
        elastic = self.elastic
        if isinstance(elastic, PlaneStress) or elastic.anisotropy or elastic.incompressible:
            raise ValueError(
                "elastic must be an isotropic PlaneStrain, Axisymmetric or Solid with poisson below "
                f"0.5, got {elastic!r}"
            )
        rows = self._rows
        if not np.isclose(rows[0, 1], self.yield_stress, rtol=1e-9):
            raise ValueError(
                f"hardening must begin with the yield stress {self.yield_stress:g} at strain 0, got "
                f"{rows[0, 1]:g}"
            )

    @property
    def state_size(self) -> int:
        return 2 * self.elastic.dim + 1

    @property
    def _rows(self) -> np.ndarray:
        """Return the table of hardening (n, 2): accumulated plastic strains and yield stresses, Pa."""
        if isinstance(self.hardening, tuple):
            return np.array(self.hardening)
        return np.array([[0.0, self.yield_stress]])

    def _slopes(self) -> np.ndarray:
        """Return the slopes (n,), Pa, of the yield stress after each row of the table."""
        last = 0.0 if isinstance(self.hardening, tuple) else cast("float", self.hardening)
        strains, stresses = self._rows.T
        return np.append(np.diff(stresses) / np.diff(strains), last)

    def _yielded(self, accumulated: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the accumulated strain after a step and the slope of hardening there; ``size`` is
        sqrt(3/2) |xi|. This solves the second formula of the module for alpha + Delta alpha."""
        strains, stresses = self._rows.T
        slopes = self._slopes()
        resisting = 3 * self.elastic.shear_modulus + self.kinematic
        # the left-hand side at the rows of the table, moved by what has been accumulated
        levels = resisting * strains + stresses
        target = size + resisting * accumulated
        row = np.maximum(np.searchsorted(levels, target, side="right") - 1, 0)
        after = strains[row] + (target - levels[row]) / (resisting + slopes[row])
        return np.maximum(after, accumulated), slopes[row]

    def response(
        self, strain: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stresses (n, k), Pa, their derivatives (n, k, k) and the new states of patches
        with strains (n, k); see :class:`~adaptmg.problem.plastic.Inelastic`."""
        # in the formulas of the module: deviator s*, relative xi, direction n, grown Delta alpha
        k = strain.shape[1]
        shear = self.elastic.shear_modulus
        bulk = self.elastic.lame + 2 * shear / 3
        normal = np.arange(k) < 3
        # components of tensors over columns of strains; how often they occur in a tensor
        share = np.where(normal, 1.0, 0.5)
        often = np.where(normal, 1.0, 2.0)
        plastic, accumulated = state[:, :k], state[:, k]
        elastic = strain - plastic
        volume = elastic[:, :3].sum(axis=1)
        deviator = 2 * shear * (share * elastic - np.where(normal, volume[:, None] / 3, 0.0))
        relative = deviator - 2 / 3 * self.kinematic * share * plastic
        norm = np.sqrt(np.einsum("ni,i,ni->n", relative, often, relative))
        size = np.sqrt(1.5) * norm
        limit = np.interp(accumulated, *self._rows.T)
        beyond = accumulated - self._rows[-1, 0]
        limit += self._slopes()[-1] * np.maximum(beyond, 0.0)
        # rounding leaves as much of a stress that the step before has put on the limit
        yields = size > limit * (1 + checks.ROUNDING)
        after, slope = self._yielded(accumulated, size)
        grown = np.where(yields, after - accumulated, 0.0)
        direction = relative / np.where(yields, norm, 1.0)[:, None]
        flow = np.sqrt(1.5) * grown
        stress = deviator - (2 * shear * flow)[:, None] * direction
        stress[:, :3] += bulk * volume[:, None]
        theta = 1 - 2 * shear * flow / np.where(yields, norm, 1.0)
        hardening = np.maximum((slope + self.kinematic) / (3 * shear), _SOFTEST)
        theta_bar = 1 / (1 + hardening) - (1 - theta)
        theta_bar = np.where(yields, theta_bar, 0.0)
        projection = np.diag(share) - np.outer(normal, normal) / 3
        tangent = bulk * np.outer(normal, normal) + 2 * shear * (
            theta[:, None, None] * projection
            - theta_bar[:, None, None] * direction[:, :, None] * direction[:, None, :]
        )
        state = np.column_stack([plastic + flow[:, None] * often * direction, accumulated + grown])
        return stress, tangent, state


def elastic_material(name: str, material: object) -> Elastic:
    """Return a material as Elastic; of an inelastic one its elastic part, with the material as its
    ``inelastic``."""
    if isinstance(material, Elastic):
        return material
    words = (
        "PlaneStrain, PlaneStress, Axisymmetric, Solid or Plastic, or map each body's name to one"
    )
    inelastic = cast("Inelastic", checks.offers(name, material, "response", words))
    elastic = checks.instance(f"elastic of {name}", getattr(material, "elastic", None), Elastic)
    if isinstance(elastic, PlaneStress) or elastic.anisotropy is not None:
        raise ValueError(
            f"elastic of {name} must be an isotropic PlaneStrain, Axisymmetric or Solid, got "
            f"{elastic!r}"
        )
    checks.integer(f"state_size of {name}", getattr(material, "state_size", None), 0)
    return replace(elastic, inelastic=inelastic)
