r"""Stress intensity factors of plane cracks by the interaction integral, with the tractions of the
faces.

With the fields :math:`\sigma^a, u^a` of a crack with :math:`K_I = 1` or :math:`K_{II} = 1`, axis 1
along it at its tip, and a weight q, 1 around the tip and 0 far from it,

.. math:: K = \frac{E'}{2}\Big[\int_A \big(\sigma_{ij} u^a_{i,1} + \sigma^a_{ij} u_{i,1}
   - \sigma^a_{kl}\, u_{k,l}\, \delta_{1j}\big)\, q_{,j}\, dA - \int_\Gamma t_i\, u^a_{i,1}\, q\, ds\Big]

(J. F. Yau, S. S. Wang and H. T. Corten, J. Appl. Mech. 47, 1980, doi:10.1115/1.3153665), over the
faces
:math:`\Gamma` with their tractions t: without them K of a closed crack is 8 to 20 % off. There :math:`u^a_{,1}` jumps
by :math:`-(\kappa + 1) / (2 \mu \sqrt{2 \pi r})`, and :math:`r = s^2` is substituted; t is a
quadratic fit of forces over boundary masses, which oscillate next to the tip. The fields are those
of M. L. Williams (J. Appl. Mech. 24, 1957) in the potentials of Muskhelishvili, with :math:`z = x_1
+ i x_2` and :math:`a = (K_I - i K_{II}) / \sqrt{8 \pi}`

.. math:: \varphi' = a\, z^{-1/2}, \qquad \psi' = (\bar a - \tfrac12 a)\, z^{-1/2} .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.stress import StressData, displacement_gradient
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_points, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays

#: radii over the largest one; this over the length of the crack, and over the distance to other boundaries
_RADII, _OF_CRACK, _OF_REST = (0.7, 0.8, 0.9, 1.0), 0.45, 0.95
#: elements along a radius at least
_ELEMENTS = 5
#: the part of the radius next to the tip where tractions are not fitted
_NEAR = 0.15
#: a crack counts as straight while its direction differs from that at the tip by less than 5 degrees
_STRAIGHT = np.cos(np.radians(5.0))


@dataclass(frozen=True)
class StressIntensity:
    """Stress intensity factors at the tip of a crack.

    Attributes
    ----------
    tip : pair of float
        m.
    K_I, K_II : float
        Opening; sliding, positive where the face to the left moves in the direction of growth. Pa
        sqrt(m), means over the radii.
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
class Tip:
    """A tip, and axes there: along the crack, and from its right face, as one looks along it, to
    its left one."""

    place: np.ndarray  # (2,)
    axes: np.ndarray  # (2, 2)
    upper: str  # the face on the left
    straight: float  # to where the crack turns, or ends, m

    def local(self, points: np.ndarray) -> np.ndarray:
        """Return the places (...,) of points (..., 2) as complex numbers."""
        return (points - self.place) @ self.axes.T @ np.array([1.0, 1j])


def tip_of(mesh: MeshArrays, crack: str, number: int) -> Tip:
    """Return the tip of this number along the path."""
    left = mesh.boundary_facets(f"{crack}.left")
    shared = np.intersect1d(left, mesh.boundary_nodes(f"{crack}.right"))
    # where the path begins, then where it ends
    ends = [
        (int(node), side, facets)
        for side, facets in (("right", left), ("left", left[:, ::-1]))
        for node in np.setdiff1d(facets[:, 0], facets[:, 1])
        if node in shared
    ]
    if not number < len(ends):
        raise ValueError(
            f"tip must be below {len(ends)}, the number of tips of {crack!r} in the body, got {number}"
        )
    last, side, facets = ends[number]
    following, place = dict(facets.tolist()), mesh.points[last]
    along = place - mesh.points[following[last]]
    along /= np.linalg.norm(along)
    while last in following:  # a path passes each node once
        step = mesh.points[last] - mesh.points[following[last]]
        if step @ along < _STRAIGHT * np.linalg.norm(step):
            break
        last = following[last]
    return Tip(
        place,
        np.array([along, [-along[1], along[0]]]),
        f"{crack}.{side}",
        float(np.linalg.norm(mesh.points[last] - place)),
    )


def stress_intensity(
    mesh: MeshArrays,
    displacement: np.ndarray,
    data: StressData,
    crack: str,
    number: int,
    radius: float | None,
    nodes: np.ndarray,
    sides: np.ndarray,
    forces: np.ndarray,
    weights: np.ndarray,
) -> StressIntensity:
    """Return the factors at a tip; ``forces`` (n, 2) act on the boundaries ``sides`` (n,) at nodes
    (n,) in contact, to which so much (n,) of these belongs."""
    tip, faces = tip_of(mesh, crack, number), [f"{crack}.left", f"{crack}.right"]
    r = np.abs(tip.local(mesh.points))
    # what is not the straight crack stays outside
    other = ~np.isin(mesh.facet_labels, list(map(mesh.boundaries.index, faces)))
    other |= (r[mesh.facets] > tip.straight * (1 + 1e-9)).any(axis=1)
    largest = min(
        _OF_CRACK * tip.straight, _OF_REST * float(r[mesh.facets[other]].min(initial=np.inf))
    )
    outer = largest if radius is None else checks.positive("radius", radius)
    if not outer <= largest:
        raise ValueError(
            f"radius must be at most {largest:.3g} m at this tip (a turn of the crack, the other tip "
            f"or another boundary is near), got {radius!r}"
        )
    ring = np.abs(r[mesh.elements].mean(axis=1) / outer - 0.6) < 0.4
    size = float(np.median(np.sqrt(4 / np.sqrt(3) * mesh.volumes[ring]))) if ring.any() else np.inf
    if not outer >= _ELEMENTS * size:
        raise ValueError(
            f"the mesh is too coarse at tip {number} of {crack!r}: a radius of {outer:.3g} m must be at "
            f"least {_ELEMENTS} elements, which are {size:.3g} m there; refine it"
        )
    own = (
        np.isin(sides, faces)
        & (r[nodes] > _NEAR * outer)
        & (r[nodes] < tip.straight - _NEAR * outer)
    )
    root = np.sqrt(weights[own])[:, None]
    on_left = np.where(sides[own] == tip.upper, 1.0, -1.0)[:, None] * forces[own] @ tip.axes.T
    fit = np.linalg.lstsq(
        root * (r[nodes[own], None] / outer) ** np.arange(3), on_left / root, rcond=None
    )[0]
    gradient = tip.axes @ displacement_gradient(mesh, displacement) @ tip.axes.T
    stress = tip.axes @ data.tensors(mesh, displacement)[:, :2, :2] @ tip.axes.T
    body = mesh.element_body[np.argmin(r[mesh.elements].mean(axis=1))]
    radii = tuple(outer * part for part in _RADII)
    fit /= outer ** np.arange(3)[:, None]
    factors = np.array(
        [
            _factors(mesh, tip, reach, gradient, stress, fit, data.lame[body], data.shear[body])
            for reach in radii
        ]
    )
    return StressIntensity(
        tuple(tip.place.tolist()),
        *factors.mean(axis=0).tolist(),
        radii,
        tuple(np.ptp(factors, axis=0).tolist()),
    )


def _factors(
    mesh: MeshArrays,
    tip: Tip,
    radius: float,
    gradient: np.ndarray,
    stress: np.ndarray,
    fit: np.ndarray,
    lame: float,
    shear: float,
) -> list[float]:
    """K_I and K_II with a domain of one radius; tractions on the left face are ``fit`` (3, 2) times
    powers of r."""
    ratio = shear / (lame + shear)  # 0 of incompressible bodies
    kolosov, modulus = 1 + 2 * ratio, 4 * shear / (1 + ratio)
    q = np.clip(2 - 2 * np.abs(tip.local(mesh.points)) / radius, 0, 1)
    ring = np.flatnonzero(np.ptp(q[mesh.elements], axis=1) > 0)
    slopes = displacement_gradient(mesh, np.column_stack([q, q]))[ring, 0] @ tip.axes.T
    rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
    z = tip.local(quadrature_points(mesh.points, mesh.elements[ring], rule))
    # along the face, from s = 0 to the root of the radius
    s, share = np.polynomial.legendre.leggauss(40)
    s, share = 0.5 * (1 + s) * np.sqrt(radius), share * np.sqrt(radius)
    traction = (share * np.clip(2 - 2 * s**2 / radius, 0, 1)) @ (
        s[:, None] ** (2 * np.arange(3)) @ fit
    )
    result = []
    for factor, part in ((1.0, traction[1]), (1j, traction[0])):
        own, slope = _near_field(z, factor, kolosov, shear)
        flux = np.einsum("nij,nqi->nqj", stress[ring], slope) + np.einsum(
            "nqij,ni->nqj", own, gradient[ring, :, 0]
        )
        flux[:, :, 0] -= np.einsum("nqij,nij->nq", own, gradient[ring])
        inside = np.einsum("n,q,nqj,nj->", mesh.volumes[ring], weights, flux, slopes)
        result.append(
            0.5 * modulus * float(inside + (kolosov + 1) / (2 * shear * np.sqrt(2 * np.pi)) * part)
        )
    return result


def _near_field(
    z: np.ndarray, factor: complex, kolosov: float, shear: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stresses (..., 2, 2) and the derivative of the displacement along the crack (..., 2), of K_I
    + i K_II."""
    a = np.conj(factor) / np.sqrt(8 * np.pi)
    first, other = a / np.sqrt(z), (np.conj(a) - 0.5 * a) / np.sqrt(z)
    second = -0.5 * first / z
    mean, difference = 2 * first.real, np.conj(z) * second + other
    stress = np.stack(
        [mean - difference.real, difference.imag, difference.imag, mean + difference.real], axis=-1
    )
    slope = (kolosov * first - np.conj(first) - z * np.conj(second) - np.conj(other)) / (2 * shear)
    return stress.reshape(*z.shape, 2, 2), np.stack([slope.real, slope.imag], axis=-1)
