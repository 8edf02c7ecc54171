r"""The end of a slip zone under Coulomb friction next to an open zone or sticking, with its exact
plane-strain field.

Rectangle (-1, 1) x (0, 1) m on the rigid plane y = 0, slip in the direction s on x > 0, open or
stick on x < 0. The top has the exact displacement, the sides have it along x; along y they have the
exact shear traction, because a support may not fix the normal displacement of the contact nodes at
which they end. With the complex potentials
:math:`\varphi = a z^\lambda,\ \psi = b z^\lambda,\ z = x + i y,\ \kappa = 3 - 4\nu` (N. I. Muskhelishvili, Some basic
problems of the mathematical theory of elasticity, 1953, section 32)

.. math:: 2\mu (u_x + i u_y) &= \kappa\varphi - z \overline{\varphi'} - \overline{\psi},\\
   \sigma_{xx} + \sigma_{yy} &= 4\,\mathrm{Re}\,\varphi',\qquad
   \sigma_{yy} - \sigma_{xx} + 2 i\,\sigma_{xy} = 2 (\bar z \varphi'' + \psi')

equilibrium holds for any a, b. The conditions :math:`u_y = 0,\ \sigma_{xy} + s f \sigma_{yy} = 0`
on x > 0 and
:math:`\sigma_{yy} = \sigma_{xy} = 0` or :math:`u_x = u_y = 0` on x < 0 are linear in a and b and have a solution, the
null vector of their matrix, if :math:`\lambda = 3/2 \pm \arctan(f \beta)/\pi,\ \beta = (1 - 2\nu) /
(2 (1 - \nu))`, with slip away from the transition or towards it. A rigid shift along the plane, or
uniform compression and shear at the limit of friction, is added so that all states are admissible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases.paper import constant_friction
from adaptmg.mesh.arrays import need_mesh

if TYPE_CHECKING:
    from adaptmg.estimate.reference_error import EnergyError
    from adaptmg.solver.result import Result


def coulomb_transition(
    *,
    law: am.Coulomb = am.Coulomb(0.5),
    kind: Literal["open", "stick"] = "open",
    sign: Literal["+", "-"] = "+",
    pressure: float = 1e8,
    young: float = 1.3e11,
    poisson: float = 0.2,
) -> am.ContactProblem:
    """Pose a transition of contact states with its exact solution; plane strain.

    ``reference`` holds ``quantity`` (as text), ``field`` (:class:`TransitionField`), ``exponent``
    (lambda), ``transition`` (0.0, m), ``uniform_rate`` (0.5: the energy error falls like N^-1/2 on
    uniform meshes of N nodes) and ``sources``.

    Parameters
    ----------
    law : Coulomb
        A constant coefficient, above 0 and at most 2.
    kind : {"open", "stick"}
        The state next to the slip zone.
    sign : {"+", "-"}
        Of lambda: "+" where the body slips away from the transition, "-" where it slips towards it.
    pressure : float
        Of "open" the pressure at x = 1, of "stick" the uniform compression, Pa, > 0.
    young, poisson : float
        Pa, and a number.

    Examples
    --------
    >>> am.cases.coulomb_transition().dim
    2
    """
    checks.choice("kind", kind, ("open", "stick"))
    checks.choice("sign", sign, ("+", "-"))
    friction = constant_friction(law) or 0.0
    if not 0 < friction <= 2:
        raise ValueError(
            "law must be Coulomb(f) with a constant f above 0 and at most 2, got "
            f"{checks.described(law)}"
        )
    pressure = checks.quantity("pressure", pressure, positive=True)
    field = _field(
        kind, sign == "+", friction, pressure, am.PlaneStrain(young=young, poisson=poisson)
    )
    moved = [partial(_displaced, field, k) for k in (0, 1)]
    return am.ContactProblem(
        name=f"Coulomb transition, slip and {kind}, {sign}",
        material=field.material,
        domain=am.Rectangle(width=2.0, height=1.0, origin=(-1.0, 0.0)),
        contact=am.Contact("bottom", am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        law=law,
        loads=tuple(
            am.Traction(side, (0.0, partial(_sheared, field, normal)))
            for side, normal in (("left", -1.0), ("right", 1.0))
        ),
        supports=(
            am.Support("top", x=moved[0], y=moved[1]),
            am.Support("left", x=moved[0]),
            am.Support("right", x=moved[0]),
        ),
        reference={
            "quantity": "displacement, m",
            "field": field,
            "exponent": field.exponent,
            "transition": 0.0,
            "uniform_rate": 0.5,
            "sources": {"field": "eigenfunction of the half plane, exact"},
        },
    )


def _field(
    kind: str, away: bool, friction: float, pressure: float, material: am.PlaneStrain
) -> TransitionField:
    """Return the mode with a size, a sign and a uniform part that make all states admissible.

    "open": the mode presses where x > 0, and there friction points against ``direction``; in front of
    it, where x < 0, the gap opens. Slip has the right sign at all nodes once the whole is shifted.
    "stick": on x < 0 the traction t must stay below the limit, direction t_xy < f p. The uniform part
    is exactly at the limit, and the mode, of either sign, is chosen to lower it there."""
    poisson = material.poisson
    direction = 1.0 if away else -1.0
    beta = (1 - 2 * poisson) / (2 * (1 - poisson))
    exponent = 1.5 + direction * math.atan(friction * beta) / math.pi
    a, b = _mode(kind, friction, poisson, exponent, direction)
    mode = TransitionField(material=material, exponent=exponent, a=a, b=b)
    # xx, yy and xy at x = 1, which slips, and at x = -1
    right, left = mode.stress(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    if kind == "open":
        # the pressure at x = 1 is that asked for
        scale = pressure / -right[1]
        uniform = 0.0
        shear = 0.0
    else:
        # direction sigma_xy + f sigma_yy, which must be negative on x < 0: of the mode alone it is ``excess``
        # at x = -1, of the sum -f times the uniform pressure, so that slipping and sticking are alike in size
        excess = direction * left[2] + friction * left[1]
        scale = -friction * pressure / excess
        uniform = pressure
        shear = direction * friction * pressure
    field = replace(mode, a=scale * a, b=scale * b, pressure=uniform, shear=shear)
    if kind == "stick":
        return field
    # shifted along the plane by twice the slip at x = 1, rounded up to micrometres, so that all nodes
    # slip in one direction
    slip = abs(float(field.displacement(np.array([[1.0, 0.0]]))[0, 0]))
    return replace(field, shift=direction * math.ceil(2e6 * slip) * 1e-6)


def _mode(
    kind: str, friction: float, poisson: float, exponent: float, direction: float
) -> tuple[complex, complex]:
    """Return the coefficients a and b: the null vector of the conditions on both sides of the
    transition."""
    # conditions at x = 1, which slips, and at x = -1, for each unit coefficient
    ends = np.array([1.0 + 0.0j, -1.0 + 0.0j])
    columns = []
    for a, b in ((1, 0), (1j, 0), (0, 1), (0, 1j)):
        u = _displacement(ends, exponent, a, b, poisson)
        s = _stress(ends, exponent, a, b)
        left = (s[1, 1], s[1, 2]) if kind == "open" else (u[1].real, u[1].imag)
        columns.append([u[0].imag, s[0, 2] + direction * friction * s[0, 1], *left])
    # real and imaginary parts of a and b: the right singular vector of the singular value zero, the last one
    *_, (a_real, a_imag, b_real, b_imag) = np.linalg.svd(np.array(columns, dtype=float).T)[2]
    return complex(a_real, a_imag), complex(b_real, b_imag)


@dataclass(frozen=True, kw_only=True)
class TransitionField:
    """Displacement and stress of one field; functions of position (n, 2), m, y >= 0."""

    material: am.PlaneStrain
    exponent: float  # lambda
    a: complex  # coefficients of the potentials, Pa m^(1 - lambda)
    b: complex
    shift: float = 0.0  # rigid displacement along x, m
    pressure: float = 0.0  # uniform compression -sigma_yy without strain along x, Pa
    shear: float = 0.0  # uniform sigma_xy, Pa

    def displacement(self, points: np.ndarray) -> np.ndarray:
        """Return u (n, 2), m, at points (n, 2)."""
        z = _complex(points)
        mu = self.material.shear_modulus
        u = _displacement(z, self.exponent, self.a, self.b, self.material.poisson) / (2 * mu)
        stretch = -self.pressure / (self.material.lame + 2 * mu)
        return np.column_stack(
            [u.real + self.shift + self.shear / mu * z.imag, u.imag + stretch * z.imag]
        )

    def stress(self, points: np.ndarray) -> np.ndarray:
        """Return the stresses xx, yy, xy (n, 3), Pa, at points (n, 2)."""
        result = _stress(_complex(points), self.exponent, self.a, self.b)
        lame = self.material.lame
        return result + np.array(
            [
                -self.pressure * lame / (lame + 2 * self.material.shear_modulus),
                -self.pressure,
                self.shear,
            ]
        )

    def energy_error(self, result: Result, points: int = 6) -> EnergyError:
        """Return the exact error of a solution of the case in the energy norm, with ``points**2``
        points an element."""
        from adaptmg.discrete.stress import full_stress
        from adaptmg.estimate.reference_error import EnergyError
        from adaptmg.geometry.quadrature import quadrature_points, simplex_rule

        mesh = need_mesh(result)
        rule, weights = simplex_rule(2, points)
        positions = quadrature_points(mesh.points, mesh.elements, rule)
        exact = self.stress(positions.reshape(-1, 2)).reshape(*positions.shape[:2], 3)
        tensors = full_stress(mesh, self.material, result.displacement)
        # xx, yy and xy of the tensors, the same at all points of an element
        difference = exact - tensors[:, None, (0, 1, 0), (0, 1, 1)]
        error, energy = (
            float(np.sum(mesh.volumes[:, None] * weights * self._density(stress)))
            for stress in (difference, exact)
        )
        return EnergyError(
            absolute=math.sqrt(error),
            relative=math.sqrt(error / energy),
            norm=math.sqrt(energy),
            allowance=0.0,  # the reference is exact
        )

    def _density(self, stress: np.ndarray) -> np.ndarray:
        """Return sigma : C^-1 sigma of stresses (..., 3), xx, yy, xy, in plane strain."""
        xx, yy, xy = np.moveaxis(stress, -1, 0)
        return (xx**2 + yy**2 + 2 * xy**2 - self.material.poisson * (xx + yy) ** 2) / (
            2 * self.material.shear_modulus
        )


def _displaced(field: TransitionField, component: int, points: np.ndarray) -> np.ndarray:
    """Return a component (n,) of the displacement, m, for a Support."""
    return field.displacement(points)[:, component]


def _sheared(field: TransitionField, normal: float, points: np.ndarray) -> np.ndarray:
    """Return the shear traction (n,), Pa, on a side with the normal (normal, 0), for a Traction."""
    return normal * field.stress(points)[:, 2]


_Complex = NDArray[np.complexfloating]


def _complex(points: np.ndarray) -> _Complex:
    """Return complex coordinates (n,); points below the plane by rounding are moved onto it, where the
    fields have a cut."""
    points = np.asarray(points, dtype=np.float64)
    return points[:, 0] + 1j * (np.maximum(points[:, 1], 0.0) + 0.0)  # + 0.0: no -0.0


def _derivatives(
    z: _Complex, exponent: float, a: complex, b: complex
) -> tuple[_Complex, _Complex, _Complex]:
    """Return phi', conj(z) phi'' and psi' (n,)."""
    slope = exponent * z ** (exponent - 1)
    # conj(z) / z as a rotation, which is finite at z = 0
    return a * slope, a * (exponent - 1) * slope * np.exp(-2j * np.angle(z)), b * slope


def _displacement(z: _Complex, exponent: float, a: complex, b: complex, poisson: float) -> _Complex:
    """Return 2 mu (u_x + i u_y) (n,)."""
    phi_slope, _, _ = _derivatives(z, exponent, a, b)
    return (3 - 4 * poisson) * a * z**exponent - z * np.conj(phi_slope) - np.conj(b * z**exponent)


def _stress(z: _Complex, exponent: float, a: complex, b: complex) -> np.ndarray:
    """Return the stresses xx, yy, xy (n, 3)."""
    phi_slope, phi_curvature, psi_slope = _derivatives(z, exponent, a, b)
    mean = 2 * phi_slope.real
    deviation = phi_curvature + psi_slope
    return np.column_stack([mean - deviation.real, mean + deviation.real, deviation.imag])
