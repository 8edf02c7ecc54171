r"""Stress intensity factors of plane cracks by the interaction integral, with the tractions of the faces.

With the fields :math:`\sigma^a, u^a` of a crack with :math:`K_I = 1` or :math:`K_{II} = 1` (M. L. Williams, J. Appl.
Mech. 24, 1957), axis 1 along the crack at its tip, and a weight q, 1 around the tip and 0 far from it,

.. math:: K = \frac{E'}{2}\Big[\int_A \big(\sigma_{ij} u^a_{i,1} + \sigma^a_{ij} u_{i,1}
   - \sigma^a_{kl}\, u_{k,l}\, \delta_{1j}\big)\, q_{,j}\, dA - \int_\Gamma t_i\, u^a_{i,1}\, q\, ds\Big]

(J. F. Yau, S. S. Wang and H. T. Corten, J. Appl. Mech. 47, 1980, doi:10.1115/1.3153665), over the faces
:math:`\Gamma` with their tractions t: without them a closed crack would open by a few percent. There
:math:`u^a_{,1} \sim r^{-1/2}`, and :math:`r = s^2` is substituted; t is a quadratic fit of forces over boundary masses,
which oscillate next to the tip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.stress import displacement_gradient
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_points, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

#: radii over the largest one; this over the length of the crack, and over the distance to other boundaries
_RADII, _OF_CRACK, _OF_REST = (0.7, 0.8, 0.9, 1.0), 0.45, 0.95
#: elements along a radius at least
_ELEMENTS = 5
#: the part of the radius next to the tip where tractions are not fitted
_NEAR = 0.15
#: of the cosine of the angle between facets that count as straight
_STRAIGHT = 1e-6


@dataclass(frozen=True)
class StressIntensity:
    """Stress intensity factors at the tip of a crack.

    Attributes
    ----------
    tip : pair of float
        m.
    K_I, K_II : float
        Opening; sliding, positive where the face to the left moves in the direction of growth. Pa sqrt(m), means over
        the radii.
    radii : tuple of float
        Of the domains of integration, m.
    spread : pair of float
        Largest minus smallest of both over the radii, Pa sqrt(m): a hint of the error.
    """

    tip: tuple[float, float]
    K_I: float
    K_II: float
    radii: tuple[float, ...]
    spread: tuple[float, float]


@dataclass(frozen=True, eq=False)
class _Tip:
    """A tip, and axes there: along the crack, and from its right face to its left one."""

    node: int
    axes: np.ndarray  # (2, 2)
    upper: str  # the face with the second coordinate > 0
    straight: float  # length of the crack up to a kink, or its end, m

    def local(self, mesh: MeshArrays, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (...,) of points (..., 2) from the tip, and angles from the first axis."""
        x, y = np.moveaxis((points - mesh.points[self.node]) @ self.axes.T, -1, 0)
        return np.hypot(x, y), np.arctan2(y, x)


def stress_intensity(result: Result, crack: str, tip: int, radius: float | None) -> StressIntensity:
    """See :meth:`adaptmg.Result.stress_intensity`."""
    mesh, data = result.mesh, result.stress_data
    if mesh.dim != 2 or data is None or data.axisymmetric or data.moduli is not None:
        raise ValueError("stress_intensity: only plane problems (PlaneStrain, PlaneStress) of isotropic bodies have "
                         "K_I and K_II here")
    checks.boundary_name("crack", crack)
    at = _tip(mesh, crack, checks.integer("tip", tip, 0))
    r = at.local(mesh, mesh.points)[0]
    largest = _largest(mesh, crack, at, r)
    outer = largest if radius is None else checks.positive("radius", radius)
    if not outer <= largest:
        raise ValueError(f"radius must be at most {largest:.3g} m at this tip (a kink, the other tip or another "
                         f"boundary is near), got {radius!r}")
    ring = np.abs(r[mesh.elements].mean(axis=1) / outer - 0.6) < 0.4
    size = float(np.quantile(np.sqrt(4 / np.sqrt(3) * mesh.volumes[ring]), 0.9)) if ring.any() else np.inf
    if not outer >= _ELEMENTS * size:
        raise ValueError(f"the mesh is too coarse at tip {tip} of {crack!r}: a radius of {outer:.3g} m must be at "
                         f"least {_ELEMENTS} elements, which are {size:.3g} m there; refine it")
    fit = _tractions(result, crack, at, outer)
    radii = tuple(outer * part for part in _RADII)
    factors = np.array([_factors(result, at, radius, fit) for radius in radii])
    K_I, K_II = factors.mean(axis=0).tolist()
    return StressIntensity(tuple(mesh.points[at.node].tolist()), K_I, K_II, radii,
                           tuple(np.ptp(factors, axis=0).tolist()))


def _tip(mesh: MeshArrays, crack: str, number: int) -> _Tip:
    """The tip of this number along the path."""
    left = mesh.boundary_facets(f"{crack}.left")
    shared = np.intersect1d(left, mesh.boundary_nodes(f"{crack}.right"))
    # where the path begins, then where it ends
    ends = [(int(node), facets) for facets in (left, left[:, ::-1]) for node in np.setdiff1d(facets[:, 0], facets[:, 1])
            if node in shared]
    if not number < len(ends):
        raise ValueError(f"tip must be below {len(ends)}, the number of tips of {crack!r} in the body, got {number}")
    node, facets = ends[number]
    following = dict(facets.tolist())
    first = mesh.points[following[node]] - mesh.points[node]
    axis, last = -first / np.linalg.norm(first), node
    while last in following:  # a path passes each node once
        step = mesh.points[following[last]] - mesh.points[last]
        if step @ axis > (_STRAIGHT - 1) * np.linalg.norm(step):
            break
        last = following[last]
    upper = f"{crack}.{'right' if facets is left else 'left'}"
    return _Tip(node, np.array([axis, [-axis[1], axis[0]]]), upper,
                float(np.linalg.norm(mesh.points[last] - mesh.points[node])))


def _largest(mesh: MeshArrays, crack: str, at: _Tip, r: np.ndarray) -> float:
    """The largest radius: around it lies nothing but the straight crack."""
    own = np.isin(mesh.facet_labels, [mesh.boundaries.index(f"{crack}.{side}") for side in ("left", "right")])
    # facets are shorter than they are away, but for coarse meshes, which are refused
    rest = r[mesh.facets[~own | (r[mesh.facets] > at.straight * (1 + _STRAIGHT)).any(axis=1)]]
    return min(_OF_CRACK * at.straight, _OF_REST * float(rest.min(initial=np.inf)))


def _tractions(result: Result, crack: str, at: _Tip, radius: float) -> np.ndarray:
    """Coefficients (3, 2) of quadratic functions of r: tractions on the upper face along both axes, Pa."""
    contact, mesh = result.contact, result.mesh
    faces = [f"{crack}.left", f"{crack}.right"]
    own = np.isin(np.array(contact.names)[contact.boundary], faces)
    r = at.local(mesh, mesh.points[contact.node])[0]
    own &= (r > _NEAR * radius) & (r < at.straight - _NEAR * radius)
    sign = np.where(np.array(contact.names)[contact.boundary[own]] == at.upper, 1.0, -1.0)
    values = sign[:, None] * (contact.force[own] / contact.weights[own, None]) @ at.axes.T
    r, weights = r[own], np.sqrt(contact.weights[own])[:, None]
    powers = r[:, None] ** np.arange(3)
    scale = radius ** np.arange(3)
    return np.linalg.lstsq(weights * powers / scale, weights * values, rcond=None)[0] / scale[:, None]


def _factors(result: Result, at: _Tip, radius: float, fit: np.ndarray) -> tuple[float, float]:
    """K_I and K_II with a domain of one radius."""
    mesh, data = result.mesh, result.stress_data
    r, _ = at.local(mesh, mesh.points)
    q = np.clip(2 - 2 * r / radius, 0, 1)
    ring = np.flatnonzero(np.ptp(q[mesh.elements], axis=1) > 0)
    slopes = displacement_gradient(mesh, np.column_stack([q, q]))[ring, 0] @ at.axes.T
    gradient = at.axes @ displacement_gradient(mesh, result.displacement)[ring] @ at.axes.T
    stress = at.axes @ data.tensors(mesh, result.displacement)[ring, :2, :2] @ at.axes.T
    body = mesh.element_body[ring[0]]
    shear = data.shear[body]
    share = shear / (data.lame[body] + shear)  # 0 of incompressible bodies
    kolosov, modulus = 1 + 2 * share, 4 * shear / (1 + share)
    rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
    distance, angle = at.local(mesh, quadrature_points(mesh.points, mesh.elements[ring], rule))
    measure = mesh.volumes[ring][:, None] * weights
    found = []
    for mode in (1, 2):
        own_stress, own_slope = _williams(mode, distance, angle, kolosov, shear)
        flux = np.einsum("nij,nqi->nqj", stress, own_slope) + np.einsum("nqij,ni->nqj", own_stress, gradient[:, :, 0])
        flux[:, :, 0] -= np.einsum("nqij,nij->nq", own_stress, gradient)
        found.append(float(np.einsum("nq,nqj,nj->", measure, flux, slopes)))
    # on the faces the slopes differ by -(kolosov + 1) / (2 shear sqrt(2 pi r)), along the second axis and the first
    s, weights = np.polynomial.legendre.leggauss(20)
    for low, high in ((0.0, np.sqrt(radius / 2)), (np.sqrt(radius / 2), np.sqrt(radius))):
        along = 0.5 * (low + high + (high - low) * s)
        weight = np.clip(2 - 2 * along**2 / radius, 0, 1) * weights * (high - low)
        traction = (along[:, None] ** (2 * np.arange(3))) @ fit
        for k in (0, 1):
            found[k] += (kolosov + 1) / (2 * shear * np.sqrt(2 * np.pi)) * float(weight @ traction[:, 1 - k])
    return 0.5 * modulus * found[0], 0.5 * modulus * found[1]


def _williams(mode: int, r: np.ndarray, angle: np.ndarray, kolosov: float, shear: float
              ) -> tuple[np.ndarray, np.ndarray]:
    """Stresses (..., 2, 2) and the derivative of the displacement along the first axis (..., 2), of a factor 1."""
    s, c, s3, c3 = np.sin(0.5 * angle), np.cos(0.5 * angle), np.sin(1.5 * angle), np.cos(1.5 * angle)
    if mode == 1:
        xx, yy, xy = c * (1 - s * s3), c * (1 + s * s3), s * c * c3
        shape = [c * (kolosov - 1 + 2 * s * s), s * (kolosov + 1 - 2 * c * c)]
        slope = [-s * (kolosov - 1 + 2 * s * s) + 4 * s * c * c, c * (kolosov + 1 - 2 * c * c) + 4 * s * s * c]
    else:
        xx, yy, xy = -s * (2 + c * c3), s * c * c3, c * (1 - s * s3)
        shape = [s * (kolosov + 1 + 2 * c * c), -c * (kolosov - 1 - 2 * s * s)]
        slope = [c * (kolosov + 1 + 2 * c * c) - 4 * s * s * c, s * (kolosov - 1 - 2 * s * s) + 4 * s * c * c]
    root = np.sqrt(2 * np.pi * r)
    stress = np.stack([xx, xy, xy, yy], axis=-1).reshape(*r.shape, 2, 2) / root[..., None, None]
    derivative = np.stack([0.5 * g * np.cos(angle) - 0.5 * d * np.sin(angle)
                           for g, d in zip(shape, slope, strict=True)], axis=-1)
    return stress, derivative / (2 * shear * root[..., None])
