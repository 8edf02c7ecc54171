r"""Stress intensity factors of plane cracks by the interaction integral, with the forces in the body
and on the faces.

With the fields :math:`\sigma^a, u^a` of a crack with :math:`K_I = 1` or :math:`K_{II} = 1`, axis 1
along it at its tip, and a weight q, 1 around the tip and 0 far from it,

.. math:: K = \frac{E'}{2}\Big[\int_A \big(\sigma_{ij} u^a_{i,1} + \sigma^a_{ij} v_{i,1}
   - \sigma^a_{kl}\, v_{k,l}\, \delta_{1j}\big)\, q_{,j}\, dA
   - \int_A \big(e_{ij}\, \sigma^a_{ij,1} + f_i\, u^a_{i,1}\big)\, q\, dA
   - \int_\Gamma t_i\, u^a_{i,1}\, q\, ds\Big]

(J. F. Yau, S. S. Wang and H. T. Corten, J. Appl. Mech. 47, 1980, doi:10.1115/1.3153665). What heat
strains freely at the tip, :math:`\varepsilon^0`, is taken off the displacement, :math:`v_{i,j} =
u_{i,j} - \varepsilon^0_{ij}`, and what it strains freely elsewhere beyond that is e: the integral of
:math:`\sigma^a_{ij}\, e_{ij,1}\, q` by parts. In plane strain both contain Poisson's ratio times the
free strain through the thickness.

Forces f of the body and tractions t of the faces :math:`\Gamma`, of contact and of loads, are the
nodal forces that the stresses need: at a face over its boundary masses. Without those of contact K
of a closed crack is 8 to 20 % off. Between the faces :math:`u^a_{,1}` jumps by :math:`-(\kappa + 1) /
(2 \mu \sqrt{2 \pi r})`, and :math:`r = s^2` is substituted; t is a quadratic fit, as forces
oscillate next to the tip. The fields are those of M. L. Williams (J. Appl. Mech. 24, 1957) in the
potentials of Muskhelishvili, with :math:`z = x_1 + i x_2` and
:math:`a = (K_I - i K_{II}) / \sqrt{8 \pi}`

.. math:: \varphi' = a\, z^{-1/2}, \qquad \psi' = (\bar a - \tfrac12 a)\, z^{-1/2} .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import shape_gradients
from adaptmg.discrete.stress import StressData, displacement_gradient
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_points, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays

#: radii over the largest one: on three meshes of a closed crack K_II is 2.2, .8 and .1 % small; with half of them 3.3,
#: 1.0 and .2 %, with the largest alone 2.1, .7 and .1 %, without a spread
_RADII = (0.7, 0.8, 0.9, 1.0)
#: the largest one over the length of the crack: K_II is 3.9, 1.1 and .3 % small with half, 1.6, .9 and .2 % with twice
_OF_CRACK = 0.45
#: the largest one over the distance to other boundaries: half changes K_II of a crack near them by .1 % at most, with
#: 1.2, which leaves the body, it is 2 % small on all meshes
_OF_REST = 0.95
#: elements along a radius at least
_ELEMENTS = 5
#: the part of the radius next to the tip where tractions are not fitted: K_II is 2.9, .9 and .2 % small with half, 1.9,
#: 1.1 and .3 % with twice
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

    Examples
    --------
    :meth:`adaptmg.Result.stress_intensity` returns them:

    >>> factors = am.solver.StressIntensity(
    ...     tip=(0.7, 0.5), K_I=8e5, K_II=0.0, radii=(0.1, 0.2), spread=(4e3, 0.0)
    ... )
    >>> factors.spread[0] / factors.K_I                            # how well the radii agree
    0.005
    """

    tip: tuple[float, float]
    K_I: float
    K_II: float
    radii: tuple[float, ...]
    spread: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Tip:
    """A tip, and axes there: along the crack in the direction of growth, and to the left of it."""

    place: np.ndarray  # (2,)
    axes: np.ndarray  # (2, 2), by row
    upper: str  # name of the face on the left
    straight: float  # distance to where the crack turns or ends, m

    def local(self, points: np.ndarray) -> np.ndarray:
        """Return the places (...,) of points (..., 2) as complex numbers."""
        return (points - self.place) @ self.axes.T @ np.array([1.0, 1j])


def tip_of(mesh: MeshArrays, crack: str, number: int) -> Tip:
    """Return the tip of this number along the path."""
    left = mesh.boundary_facets(f"{crack}.left")
    shared = np.intersect1d(left, mesh.boundary_nodes(f"{crack}.right"))
    # Facets of the left face run along the path, begin -> ... -> end. At its begin, where facets start
    # and none ends, the crack grows against the path, and has the right face on its left; at its end
    # it grows along the path, and has the left face there. Both ends are the first node of facets that
    # lead away from the tip: of those along the path, of reversed ones. A mouth has two nodes, a tip one.
    ends = [
        (int(node), upper, facets)
        for upper, facets in (("right", left), ("left", left[:, ::-1]))
        for node in np.setdiff1d(facets[:, 0], facets[:, 1])
        if node in shared
    ]
    if not number < len(ends):
        raise ValueError(
            f"tip must be below {len(ends)}, the number of tips of {crack!r} in the body, got {number}"
        )
    node, upper, facets = ends[number]
    following = dict(facets.tolist())
    place = mesh.points[node]
    along = place - mesh.points[following[node]]
    along /= np.linalg.norm(along)
    while node in following:  # away from the tip; a path passes each node once
        step = mesh.points[node] - mesh.points[following[node]]
        if step @ along < _STRAIGHT * np.linalg.norm(step):
            break
        node = following[node]
    return Tip(
        place=place,
        axes=np.array([along, [-along[1], along[0]]]),
        upper=f"{crack}.{upper}",
        straight=float(np.linalg.norm(mesh.points[node] - place)),
    )


def stress_intensity(
    mesh: MeshArrays,
    displacement: np.ndarray,
    data: StressData,
    crack: str,
    number: int,
    radius: float | None,
) -> StressIntensity:
    """Return the factors at tip ``number`` of a crack, from a displacement (n_nodes, 2), with a domain of at
    most ``radius``, m."""
    tip = tip_of(mesh, crack, number)
    faces = [f"{crack}.left", f"{crack}.right"]
    r = np.abs(tip.local(mesh.points))
    at_tip = (mesh.elements == np.argmin(r)).any(axis=1)
    lame, shear = _of_one_material(mesh, data, np.flatnonzero(at_tip))
    other_material = (data.lame != lame) | (data.shear != shear)
    largest = _largest_radius(mesh, tip, r, faces, other_material[mesh.element_body])
    outer = largest if radius is None else checks.positive("radius", radius)
    if not outer <= largest:
        raise ValueError(
            f"radius must be at most {largest:.3g} m at this tip (a turn of the crack, the other tip, "
            f"another boundary or another material is near), got {radius!r}"
        )
    element_size = _element_size(mesh, r, outer)
    if not outer >= _ELEMENTS * element_size:
        raise ValueError(
            f"the mesh is too coarse at tip {number} of {crack!r}: a radius of {outer:.3g} m must be at "
            f"least {_ELEMENTS} elements, which are {element_size:.3g} m there; refine it"
        )
    # fields in the axes of the tip; forces on the faces become tractions, the others act in the body
    stress = data.tensors(mesh, displacement)[:, :2, :2]
    forces = _nodal_forces(mesh, stress) @ tip.axes.T
    fit = _fitted_tractions(mesh, tip, faces, forces, outer)
    for face in faces:
        forces[mesh.boundary_nodes(face)] = 0.0
    free_strains = tip.axes @ _free_strain(mesh, data, lame, shear) @ tip.axes.T
    free_at_tip = free_strains[at_tip].mean(axis=0)
    fields = _Fields(
        mesh=mesh,
        tip=tip,
        gradient=tip.axes @ displacement_gradient(mesh, displacement) @ tip.axes.T - free_at_tip,
        stress=tip.axes @ stress @ tip.axes.T,
        uneven=free_strains - free_at_tip,
        forces=forces,
        fit=fit,
        lame=lame,
        shear=shear,
    )
    radii = tuple(outer * part for part in _RADII)
    factors = np.array([fields.factors(reach) for reach in radii])
    return StressIntensity(
        tuple(tip.place.tolist()),
        *factors.mean(axis=0).tolist(),
        radii=radii,
        spread=tuple(np.ptp(factors, axis=0).tolist()),
    )


def _largest_radius(
    mesh: MeshArrays, tip: Tip, r: np.ndarray, faces: list[str], other_material: np.ndarray
) -> float:
    """Return the largest radius of a domain, m, which must not reach other boundaries, the crack beyond
    a turn, or elements of another material, a mask (n_elements,); ``r`` (n_nodes,) are the distances
    from the tip."""
    on_straight_crack = np.isin(mesh.facet_labels, list(map(mesh.boundaries.index, faces)))
    # up to rounding, as the distance of the turn is one of these
    on_straight_crack &= (r[mesh.facets] <= tip.straight * (1 + 1e-9)).all(axis=1)
    distance = min(
        r[mesh.facets[~on_straight_crack]].min(initial=np.inf),
        r[mesh.elements[other_material]].min(initial=np.inf),
    )
    return min(_OF_CRACK * tip.straight, _OF_REST * float(distance))


def _element_size(mesh: MeshArrays, r: np.ndarray, radius: float) -> float:
    """Return the median size, m, of the elements at .2 to 1 of a radius, the edge of an equilateral one of
    the same area; infinite if there are none. ``r`` (n_nodes,) are the distances from the tip."""
    ring = np.abs(r[mesh.elements].mean(axis=1) / radius - 0.6) < 0.4  # .2 to 1
    sizes = np.sqrt(4 / np.sqrt(3) * mesh.volumes[ring])
    return float(np.median(sizes)) if len(sizes) else np.inf


def _of_one_material(
    mesh: MeshArrays, data: StressData, elements: np.ndarray
) -> tuple[float, float]:
    """Return Lame's constants of the elements at a tip; ValueError if they differ."""
    bodies = np.unique(mesh.element_body[elements])
    constants = np.unique(np.column_stack([data.lame, data.shear])[bodies], axis=0)
    if len(constants) > 1:
        names = " and ".join(repr(mesh.bodies[body]) for body in bodies)
        raise ValueError(
            f"the tip lies between {names}, of different materials: stresses oscillate there, and "
            "K_I and K_II do not describe them"
        )
    return tuple(constants[0].tolist())


def _nodal_forces(mesh: MeshArrays, stress: np.ndarray) -> np.ndarray:
    """Return the forces (n_nodes, 2) that balance stresses (n_elements, 2, 2)."""
    slopes, volumes = shape_gradients(mesh)
    parts = np.einsum("n,nij,nkj->nki", volumes, stress, slopes)
    result = np.zeros(mesh.points.shape)
    np.add.at(result, mesh.elements, parts)
    return result


def _fitted_tractions(
    mesh: MeshArrays, tip: Tip, faces: list[str], forces: np.ndarray, outer: float
) -> np.ndarray:
    """Return the tractions on the left face as coefficients (3, 2) of powers of r, fitted to the nodal
    ``forces`` (n_nodes, 2), in the axes of the tip, on both faces; on the right face they are opposite.
    ``outer`` is the radius of the largest domain, m."""
    places = []
    masses = []
    loads = []
    for face in faces:
        surface = mesh.surface(face)
        places.append(np.abs(tip.local(mesh.points[surface.nodes])))
        masses.append(surface.lumped(axisymmetric=False)[surface.nodes])
        loads.append((1.0 if face == tip.upper else -1.0) * forces[surface.nodes])
    r, mass, load = map(np.concatenate, (places, masses, loads))
    # least squares for tractions load / mass, weighted with the mass. Beyond the domain they may be singular:
    # with them K_I of a closed crack with kinks is .027 P sqrt(pi a) on all meshes in place of 0
    fitted = (r > _NEAR * outer) & (r < outer)
    root = np.sqrt(mass[fitted])[:, None]
    powers = (r[fitted, None] / outer) ** np.arange(3)
    fit = np.linalg.lstsq(root * powers, load[fitted] / root, rcond=None)[0]
    return fit / outer ** np.arange(3)[:, None]


def _free_strain(mesh: MeshArrays, data: StressData, lame: float, shear: float) -> np.ndarray:
    """Return the free strains in the plane (n_elements, 2, 2); in plane strain with Poisson's ratio, from
    Lame's constants at the tip, times the free strain through the thickness."""
    if not len(data.initial_strain):
        return np.zeros((len(mesh.elements), 2, 2))
    through = np.where(data.thin[mesh.element_body], 0.0, data.initial_strain[:, 2])
    poisson = 0.5 * lame / (lame + shear)
    plane = data.initial_strain[:, :2] + poisson * through[:, None]
    return plane[:, :, None] * np.eye(2)


@dataclass(frozen=True, eq=False)
class _Fields:
    """A solution in the axes of a tip."""

    mesh: MeshArrays
    tip: Tip
    gradient: np.ndarray  # (n_elements, 2, 2): of the displacement without free expansion
    stress: np.ndarray  # (n_elements, 2, 2)
    uneven: np.ndarray  # (n_elements, 2, 2): free strain beyond that at the tip
    forces: np.ndarray  # (n_nodes, 2): in the body; 0 at the nodes of the faces, and so at the tip
    fit: np.ndarray  # (3, 2): tractions on the left face by powers of r
    lame: float  # Lame's constants at the tip, Pa
    shear: float

    def factors(self, radius: float) -> list[float]:
        """Return K_I and K_II with a domain of one radius."""
        mesh = self.mesh
        tip = self.tip
        shear = self.shear
        ratio = shear / (self.lame + shear)  # 0 of incompressible bodies
        kolosov = 1 + 2 * ratio  # kappa, 3 - 4 nu in plane strain; E' = 8 mu / (kappa + 1)
        modulus = 4 * shear / (1 + ratio)
        place = tip.local(mesh.points)
        # 1 up to half of the radius, then linear to 0
        q = np.clip(2 - 2 * np.abs(place) / radius, 0, 1)
        inside = np.flatnonzero(q[mesh.elements].any(axis=1))
        # the gradient of q, in the axes of the tip, as that of a component of a displacement
        slopes = displacement_gradient(mesh, np.column_stack([q, q]))[inside, 0] @ tip.axes.T
        # the integrals over the elements where q does not vanish
        # the largest degree there is: the fields of the tip are no polynomials
        rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
        z = tip.local(quadrature_points(mesh.points, mesh.elements[inside], rule))
        gradient = self.gradient[inside]
        stress = self.stress[inside]
        measures = mesh.volumes[inside, None] * weights
        weight_at_points = q[mesh.elements[inside]] @ rule.T
        loaded = np.flatnonzero((q > 0) & self.forces.any(axis=1))
        # int t q r^-1/2 dr along the face = int 2 t q ds with r = s^2, by Gauss points from s = 0 to R^1/2
        # of the radius R: many, as q has a kink at R / 2. From (-1, 1) they scale by R^1/2 / 2, so that
        # their weights take R^1/2
        s, gauss_weights = np.polynomial.legendre.leggauss(40)
        s = 0.5 * (1 + s) * np.sqrt(radius)
        gauss_weights = gauss_weights * np.sqrt(radius)
        sliding, opening = (gauss_weights * np.clip(2 - 2 * s**2 / radius, 0, 1)) @ (
            s[:, None] ** (2 * np.arange(3)) @ self.fit
        )
        result = []
        # the faces of K_I = 1 move apart along axis 2, those of K_II = 1 slide along axis 1
        for factor, traction in ((1.0, opening), (1j, sliding)):
            near_field, displacement_derivative, stress_derivative = _near_field(
                z, factor, kolosov, shear
            )
            # sigma_ij u^a_i,1 + sigma^a_ij v_i,1 - sigma^a_kl v_k,l delta_1j, times q_,j
            flux = np.einsum("nij,nqi->nqj", stress, displacement_derivative)
            flux += np.einsum("nqij,ni->nqj", near_field, gradient[:, :, 0])
            flux[:, :, 0] -= np.einsum("nqij,nij->nq", near_field, gradient)
            integral = np.einsum("nq,nqj,nj->", measures, flux, slopes)
            # e_ij sigma^a_ij,1 q, then f_i u^a_i,1 q at nodes
            integral -= np.einsum(
                "nq,nqij,nij->", measures * weight_at_points, stress_derivative, self.uneven[inside]
            )
            _, displacement_derivative, _ = _near_field(place[loaded], factor, kolosov, shear)
            integral -= np.einsum(
                "n,ni,ni->", q[loaded], displacement_derivative, self.forces[loaded]
            )
            # - t_i u^a_i,1 q of both faces, where u^a_,1 jumps by -(kappa + 1) / (2 mu sqrt(2 pi r))
            integral += (kolosov + 1) / (2 * shear * np.sqrt(2 * np.pi)) * traction
            result.append(0.5 * modulus * float(integral))
        return result


def _near_field(
    z: np.ndarray, factor: complex, kolosov: float, shear: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stresses (..., 2, 2) of K_I + i K_II = ``factor`` at places z = x_1 + i x_2 (...,), the
    derivative of the displacement along the crack (..., 2) and that of the stresses (..., 2, 2), all in the
    axes of the tip; ``kolosov`` is kappa, ``shear`` mu, Pa."""
    # phi_1, phi_2, psi_1 are phi', phi'', psi' of the module, phi''' = -1.5 phi'' / z, psi'' = -0.5 psi' / z;
    # 2 mu u = kappa phi - z conj(phi') - conj(psi)
    a = np.conj(factor) / np.sqrt(8 * np.pi)
    phi_1 = a / np.sqrt(z)
    psi_1 = (np.conj(a) - 0.5 * a) / np.sqrt(z)
    phi_2 = -0.5 * phi_1 / z
    stress = _stress(phi_1, np.conj(z) * phi_2 + psi_1)
    stress_derivative = _stress(phi_2, phi_2 - 1.5 * np.conj(z) * phi_2 / z - 0.5 * psi_1 / z)
    displacement_derivative = (
        kolosov * phi_1 - np.conj(phi_1) - z * np.conj(phi_2) - np.conj(psi_1)
    ) / (2 * shear)
    return (
        stress,
        np.stack([displacement_derivative.real, displacement_derivative.imag], axis=-1),
        stress_derivative,
    )


def _stress(mean: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Return the stresses (..., 2, 2) of ``mean`` = phi' and ``difference`` = conj(z) phi'' + psi':
    sigma_11 + sigma_22 = 4 Re phi', sigma_22 - sigma_11 + 2 i sigma_12 = 2 (conj(z) phi'' + psi')."""
    twice = 2 * np.real(mean)
    real = np.real(difference)
    imaginary = np.imag(difference)
    parts = [twice - real, imaginary, imaginary, twice + real]
    return np.stack(parts, axis=-1).reshape(*twice.shape, 2, 2)
