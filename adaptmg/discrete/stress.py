r"""Strain and stress, element by element, from a P1 displacement; and continuous in each body.

.. math:: \varepsilon = \tfrac12(\nabla u + \nabla u^T), \qquad \sigma = C (\varepsilon - \varepsilon_0)

with the initial strain :math:`\varepsilon_0`, if any, and the tensors C of
:mod:`adaptmg.discrete.moduli`. Both are constant on an element, but for the hoop strain :math:`u_r
/ r` of axisymmetric bodies, whose mean over the volume is taken: its value at the centroid,
:math:`\int u_r \big/ \int r`. The strain energy is
:math:`\tfrac12 \int \sigma : (\varepsilon - \varepsilon_0)`, by the quadrature of the stiffness matrix.

Smoothed elements have the stress that is in equilibrium, :math:`\sum_T V_T\, \sigma_T :
\varepsilon_T(v) = b^T v`: by means around edges (S of :mod:`adaptmg.discrete.elasticity`), with the
mean pressure p of the groups of their corners (:mod:`adaptmg.discrete.volumes`): :math:`\sigma =
C\,S(\varepsilon - \varepsilon_0) + p I`.

Nodal values of what is constant on elements come from a linear fit around each node,

.. math:: \sum_e \big|\sigma_e - a - B (x_e - x_i)\big|^2 \to \min, \qquad \sigma^*_i = a

over the elements e around node i, with centroids :math:`x_e` (O. C. Zienkiewicz and J. Z. Zhu, Int.
J. Numer. Meth. Engng 33, 1992, doi:10.1002/nme.1620330702). Patches of boundary nodes lie on one
side, where a fit around the node is far less accurate (on the symmetry lines of a plate with a hole
three times): a boundary node takes the mean of the fits of the inner nodes around it, at its place;
one without such nodes, a corner, a fit to the patches of all nodes of its elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast, get_args

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg.discrete.elasticity import (
    element_measures,
    elements_of_nodes,
    pattern,
    separate_bodies,
    shape_gradients,
    smoothed,
    starts_of,
)
from adaptmg.discrete.loads import body_elements, mean_initial_strain
from adaptmg.discrete.moduli import (
    PAIRS,
    Materials,
    Moduli,
    as_tensors,
    body_materials,
    is_axisymmetric,
    isotropic,
    lame_constants,
    moduli,
    strain_columns,
)
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays, places_of
from adaptmg.problem.laws import EDGE_PART, PlaneStress
from adaptmg.problem.loads import InitialStrain, Load, Preload


def element_strain(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return symmetric small-strain tensors (n_elements, dim, dim) in the plane (3D: full), initial
    strains included.

    The displacement is (n_nodes, dim) or (n_dofs,), m.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.discrete.element_strain(mesh, 1e-3 * mesh.points)[0].round(9).tolist()
    [[0.001, 0.0], [0.0, 0.001]]
    """
    gradient = displacement_gradient(checks.instance("mesh", mesh, MeshArrays), displacement)
    return 0.5 * (gradient + np.swapaxes(gradient, 1, 2))


def displacement_gradient(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return the gradients d u_i / d x_j (n_elements, dim, dim) of a displacement (n_nodes, dim) or
    (n_dofs,), m."""
    slopes, _ = shape_gradients(mesh)
    gradients = np.zeros((len(slopes), mesh.dim, mesh.dim))
    # of a copy, which can be written: kernels are compiled separately for arrays that cannot
    _add_gradients(mesh.elements, slopes, np.array(_nodal(mesh, displacement)), gradients)
    return gradients


@kernel
def _add_gradients(elements, slopes, u, gradients):
    """Add the gradients d u_i / d x_j = sum_k u_ki d phi_k / d x_j to ``gradients`` (n_elements, dim,
    dim), with the displacement ``u`` (n_nodes, dim) and the gradients ``slopes`` (n_elements, dim + 1, dim)
    of the shape functions: for 34 000 triangles in a third of the time of products of columns in numpy."""
    dim = u.shape[1]
    for e in range(len(elements)):
        for k in range(dim + 1):
            node = elements[e, k]
            for i in range(dim):
                for j in range(dim):
                    gradients[e, i, j] += u[node, i] * slopes[e, k, j]


def hoop_strain(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return the mean hoop strain u_r / r (n_elements,) of axisymmetric elements at a displacement
    (n_nodes, 2) or (n_dofs,), m."""
    u = _nodal(mesh, displacement)
    return u[mesh.elements, 0].sum(axis=1) / mesh.points[mesh.elements, 0].sum(axis=1)


#: Poisson's ratio beyond which linear elements lock: measured on an upset block of 16 x 16 cells, the compression is
#: .1 % large at .45, .2 % small at .475, .9 % at .49
LOCKING = 0.45
#: kinds of bodies in StressData
_PLAIN, _THIN, _AXISYMMETRIC = 0, 1, 2


@dataclass(frozen=True, eq=False)
class PlasticState:
    """The states of plastic bodies, and the stresses and plastic strains in them."""

    # (n_patches, n): of the patches of all plastic bodies, in the form of their materials
    state: np.ndarray
    stress: np.ndarray  # (n_elements, 3, 3): of elastic bodies too, Pa
    strain: np.ndarray  # (n_elements, 3, 3): plastic strain, 0 in elastic bodies
    accumulated: np.ndarray  # (n_elements,): the last number of the material's state


@dataclass(frozen=True, eq=False)
class StressData:
    """Materials and strains from which stresses follow, next to a mesh and a displacement, (n_nodes, dim)
    or (n_dofs,), m.
    A result on a mesh has it. A result of a bare DiscreteProblem answers :meth:`Result.stress` after
    ``dataclasses.replace(result, mesh=mesh, stress_data=am.solver.StressData.of(mesh, material))``.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.solver.StressData.of(mesh, am.PlaneStrain(young=1.0, poisson=0.25)).shear.tolist()     # Pa
    [0.4]
    """

    lame: np.ndarray  # (n_bodies,): Lame constants as they enter the stress, Pa
    shear: np.ndarray  # (n_bodies,), Pa
    kind: np.ndarray  # (n_bodies,) int8: 0 for plane strain and solids, 1 for plane stress, 2 for axisymmetric bodies
    initial_strain: np.ndarray  # (n_elements, 3), or (0, 3) for none
    smoothed: bool = False  # whether the elements are smoothed
    # with groups of nodes (adaptmg.discrete.volumes): (n_elements,) mean pressures of the corners,
    # tension positive, Pa
    pressure: np.ndarray | None = None
    volume_energy: float = 0.0  # energy of these pressures, J (plane: J/m)
    # with an anisotropic body, whose Lame constants are those of an isotropic one near it
    moduli: Moduli | None = None
    plastic: PlasticState | None = None  # of the displacement of a result with plastic bodies

    @property
    def locking(self) -> float:
        """Return the largest Poisson's ratio of bodies whose elements lock; 0 if none do."""
        ratios = self.lame / (2 * (self.lame + self.shear))
        # a ratio of .45 itself, computed from Lame's constants, has rounding
        locked = (ratios > LOCKING + 1e-9) & (self.kind != _THIN) & (not self.smoothed)
        return float(ratios[locked].max(initial=0.0))

    @classmethod
    def of(
        cls,
        mesh: MeshArrays,
        material: Materials,
        loads: Sequence[Load] = (),
        elements: str = "linear",
    ) -> StressData:
        """Return the data of materials (one, or body name -> Elastic) and of the initial strains
        among loads."""
        materials = body_materials(mesh, material)
        thick = _AXISYMMETRIC if is_axisymmetric(materials) else _PLAIN  # of all bodies or of none
        kind = [_THIN if isinstance(elastic, PlaneStress) else thick for elastic in materials]
        strains = [load for load in loads if isinstance(load, InitialStrain)]
        anisotropic = any(elastic.anisotropy for elastic in materials)
        return cls(
            *lame_constants(materials),
            kind=np.array(kind, dtype=np.int8),
            initial_strain=mean_initial_strain(
                mesh, strains, axisymmetric=is_axisymmetric(materials)
            )
            if strains
            else np.zeros((0, 3)),
            smoothed=elements == "smoothed",
            moduli=moduli(mesh, materials, elements) if anisotropic else None,
        )

    @property
    def thin(self) -> np.ndarray:
        """Return the mask (n_bodies,) of bodies in plane stress."""
        return self.kind == _THIN

    @property
    def axisymmetric(self) -> bool:
        """Return whether x is the radius r, and y the axial coordinate z."""
        return bool((self.kind == _AXISYMMETRIC).any())

    def of_elements(self, mesh: MeshArrays) -> Moduli:
        """Return the tensors of the elements; of smoothed elements those for the means around edges."""
        if self.moduli is not None:
            return self.moduli
        return isotropic(
            self.lame, self.shear, self.thin, mesh, EDGE_PART if self.smoothed else np.inf
        )

    def tensors(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return the stress tensors (n_elements, 3, 3) as of :func:`full_stress`; where there are
        plastic bodies those of the displacement of the result."""
        return as_tensors(self.columns(mesh, displacement))

    def columns(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return the components (n_elements, 2 dim), Pa, of the tensors of :meth:`tensors` in the order
        of :mod:`adaptmg.discrete.moduli`."""
        if self.plastic is not None:
            i, j = PAIRS[: 2 * mesh.dim].T
            return self.plastic.stress[:, i, j]
        return self._stress(mesh, self._elastic(mesh, displacement))

    def strains(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return strain tensors (n_elements, 3, 3) with initial strains, through the thickness and
        of the hoop, too."""
        strain = self._elastic(mesh, displacement)
        thin = self.thin[mesh.element_body]
        if thin.any():
            # the row zz of sheets gives this strain, not a stress
            strain[thin, 2] = self.of_elements(mesh).stress(strain)[thin, 2]
        if len(self.initial_strain):
            strain[:, :3] += self.initial_strain
        strain[:, 3:] *= 0.5  # angles
        return as_tensors(strain)

    def suppressed(self, mesh: MeshArrays) -> float:
        """Return twice the energy of the stresses that suppress the initial strains, N m: the square
        of their energy norm, int eps_0 : C eps_0, of smoothed elements sum V eps_0 : C S eps_0. In plane
        bodies stresses in the plane count, as no displacement changes the others."""
        of_elements = self.of_elements(mesh)
        volume = element_measures(mesh, self.axisymmetric)
        strain = np.zeros((len(volume), 2 * mesh.dim))
        strain[:, :3] = self.initial_strain
        strain[self.thin[mesh.element_body], 2] = 0.0  # sheets are free to become thicker
        stress = of_elements.stress(strain)
        plane = mesh.dim == 2 and not self.axisymmetric
        if plane:
            stress = stress[:, [0, 1, 3]]  # xx, yy and xy: without zz
        # C S eps_0 = S C eps_0: bodies share no edges. One S, as in the stiffness
        means = smoothed(mesh, stress, volume) if self.smoothed else stress
        return float(volume @ of_elements.work(stress, means, plane))

    def energy(self, mesh: MeshArrays, displacement: np.ndarray) -> float:
        """Return the strain energy, J (plane: J/m); where there are plastic bodies that of their
        elastic strains."""
        if self.plastic is not None:
            # stresses of plastic bodies are whole, with what groups of nodes bear: so must be their tensors
            whole = replace(self, smoothed=False).of_elements(mesh)
            stress = self.columns(mesh, displacement)
            work = whole.work(stress, stress, plane=False)
            return 0.5 * float(element_measures(mesh, self.axisymmetric) @ work)
        elastic = self._elastic(mesh, displacement)
        u = _nodal(mesh, displacement)
        stress = replace(self, pressure=None)._stress(mesh, elastic)
        volumes = element_measures(mesh, self.axisymmetric)
        energy = 0.5 * float(np.einsum("n,nk,nk->", volumes, stress, elastic)) + self.volume_energy
        if not self.axisymmetric or self.smoothed:
            return energy
        # the energy of hoop strains that vary within elements
        rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
        hoop = hoop_strain(mesh, u)
        radii = mesh.points[mesh.elements, 0] @ rule.T
        # u_r / r less its mean, and half of 2 pi r C_hoop times its square
        variation = u[mesh.elements, 0] @ rule.T / radii - hoop[:, None]
        stiffness = self.of_elements(mesh).of_hoop()[:, 2] * mesh.volumes
        return energy + np.pi * float(
            np.einsum("n,nq,q->", stiffness, radii * variation**2, weights)
        )

    def _elastic(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return the columns (n_elements, 2 dim) of the strain minus initial strain; of plane stress
        without the strain through the thickness."""
        if len(self.kind) != len(mesh.bodies) or len(self.initial_strain) not in (
            0,
            len(mesh.elements),
        ):
            raise ValueError(
                f"stress data of {len(self.kind)} bodies and {len(self.initial_strain)} elements do not "
                f"belong to a mesh of {len(mesh.bodies)} and {len(mesh.elements)}"
            )
        strain = strain_columns(displacement_gradient(mesh, displacement))
        if self.axisymmetric:
            strain[:, 2] = hoop_strain(mesh, displacement)
        if len(self.initial_strain):
            strain[:, :3] -= self.initial_strain
        # the tensors of sheets account for the free strain through the thickness
        strain[self.thin[mesh.element_body], 2] = 0.0
        return strain

    def _stress(self, mesh: MeshArrays, strain: np.ndarray) -> np.ndarray:
        """Return the columns (n_elements, 2 dim), Pa, of the stresses of elastic strains (n_elements, 2 dim)."""
        if self.smoothed:
            strain = smoothed(mesh, strain, element_measures(mesh, self.axisymmetric))
        stress = self.of_elements(mesh).stress(strain)
        if self.pressure is not None:
            stress[:, :3] += self.pressure[:, None]
        # the row zz of sheets gave the strain through the thickness
        stress[self.thin[mesh.element_body], 2] = 0.0
        return stress


def full_stress(
    mesh: MeshArrays, material: Materials, displacement: np.ndarray, loads: Sequence[Load] = ()
) -> np.ndarray:
    """Return Cauchy stresses (n_elements, 3, 3) of linear elements, Pa, tension positive, with that
    out of the plane.

    In 2D [2, 2] is the stress through the thickness (0 in plane stress) or the hoop stress; the
    shear stresses out of the plane are 0. The displacement is (n_nodes, dim) or (n_dofs,), m;
    initial strains among the loads carry no stress, other loads do not matter.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> material = am.PlaneStrain(young=1e9, poisson=0.25)
    >>> stress = am.discrete.full_stress(mesh, material, 1e-3 * mesh.points)           # Pa
    >>> stress[0].diagonal().round(3).tolist()
    [1600000.0, 1600000.0, 800000.0]
    """
    checks.instance("mesh", mesh, MeshArrays)
    loads = checks.items("loads", loads, get_args(Load), "Pressure, Traction, BodyForce, ...")
    return StressData.of(mesh, material, loads).tensors(mesh, displacement)


def von_mises(stress: np.ndarray) -> np.ndarray:
    r"""Return equivalent stresses :math:`\sqrt{\tfrac32\, s : s}` (n,), Pa, of the deviators s of
    tensors (n, 3, 3).

    Examples
    --------
    >>> am.discrete.von_mises(np.diag([2e6, 0.0, 0.0])[None]).round(3).tolist()      # Pa
    [2000000.0]
    """
    if np.shape(stress)[1:] != (3, 3):
        raise ValueError(
            f"stress must have shape (n, 3, 3), as of full_stress, got {np.shape(stress)}"
        )
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))


def _nodal(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return the displacement as float (n_nodes, dim), its shape checked."""
    u = checks.real_array(displacement)
    if u is None:
        raise TypeError(f"displacement must be real numbers, got {checks.shown(displacement)}")
    if u.shape not in (mesh.points.shape, (mesh.points.size,)):
        raise ValueError(f"displacement must have shape {mesh.points.shape}, got {u.shape}")
    return np.ascontiguousarray(u.reshape(mesh.points.shape), dtype=np.float64)


def cut_force(
    mesh: MeshArrays, data: StressData, displacement: np.ndarray, preload: Preload
) -> float:
    r"""Return the tension across the cut of a preload, N; ValueError if no element of the body lies
    across it.

    With the nodal function chi, 1 beyond the cut and 0 before it, and the axis a, the tension is the
    virtual work :math:`\int \sigma : \nabla (\chi a)` of a unit motion of the part beyond the cut."""
    elements = body_elements(mesh, preload.body)
    axis = preload.direction
    nodes = np.unique(mesh.elements[elements])
    coordinates = mesh.points[nodes, axis]
    cut = 0.5 * (coordinates.min() + coordinates.max()) if preload.at is None else preload.at
    if not coordinates.min() < cut < coordinates.max():
        raise ValueError(
            f"at of the preload of {preload.body!r} must be in ({coordinates.min():g}, {coordinates.max():g}), the "
            f"extent of the body along {preload.axis}, got {cut:g}"
        )
    unit_motion = np.zeros(mesh.points.shape)
    unit_motion[nodes[coordinates > cut], axis] = 1.0
    slopes = displacement_gradient(mesh, unit_motion)[elements]
    stress = data.tensors(mesh, displacement)[elements, : mesh.dim, : mesh.dim]
    volumes = element_measures(mesh, data.axisymmetric)[elements]
    return float(np.einsum("n,nij,nij->", volumes, stress, slopes))


def cut_stiffness(mesh: MeshArrays, material: Materials, preload: Preload) -> float:
    """Return the force, N, by which the body of a preload with free sides resists a strain of 1 along the
    axis, in its mean section."""
    elements = body_elements(mesh, preload.body)
    young = body_materials(mesh, material)[mesh.bodies.index(preload.body)].young
    volume = element_measures(mesh, is_axisymmetric(material))[elements].sum()
    # E times the mean section, the volume over the length
    return float(young * volume / np.ptp(mesh.points[mesh.elements[elements], preload.direction]))


def recovered(mesh: MeshArrays, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of :func:`~adaptmg.discrete.elasticity.separate_bodies`, and nodal values (n,
    n_values) of those (n_elements, n_values) of elements.

    An inner node takes the value of the fit around it. Another node takes the mean of the fits of
    its inner neighbours there, or else that of a fit to the elements of all its neighbours."""
    cells, points = separate_bodies(mesh)
    corners = cells.shape[1]
    centroids = sum(mesh.points.take(nodes, axis=0) for nodes in mesh.elements.T) / corners
    begin, elements = elements_of_nodes(cells, len(points))
    # which elements are at which nodes (n_points, n_elements), and the transpose
    incidence = sparse.csr_array(
        (np.ones(cells.size), elements, begin), shape=(len(points), len(cells))
    )
    transposed = sparse.csr_array(
        (np.ones(cells.size), cells.reshape(-1), corners * np.arange(len(cells) + 1)),
        shape=(len(cells), len(points)),
    )
    inner = _surrounded_nodes(cells, (begin, elements))
    fits, determined = _fits(incidence[inner], points[inner], centroids, values)
    inner = inner[determined]
    fits = fits[determined]
    nodal = np.zeros((len(points), values.shape[1]))
    nodal[inner] = fits[:, 0]
    outer = np.setdiff1d(np.arange(len(points)), inner)
    # entries are the numbers of elements that an outer node and another one share
    shared = sparse.coo_array(incidence[outer] @ transposed)
    weights = _add_extrapolated(nodal, points, outer, shared, inner, fits)
    nodal[weights > 0] /= weights[weights > 0, None]
    # outer nodes without an inner neighbour, as at corners: the elements of all their neighbours
    corner_nodes = outer[weights[outer] == 0]
    wider_patches = incidence[corner_nodes] @ transposed @ incidence
    # a of each fit, or the mean
    nodal[corner_nodes] = _fits(wider_patches, points[corner_nodes], centroids, values)[0][:, 0]
    return cells, nodal


def _surrounded_nodes(cells: np.ndarray, by_node: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the inner nodes of ``cells`` (n, dim + 1), of which each node has those that
    :func:`elements_of_nodes` returned. By Euler's formula F elements that surround a node have F other nodes, in
    space F / 2 + 2; around a boundary node they have more."""
    indptr, _ = pattern(by_node, starts_of(cells), cells.reshape(-1))
    n_others = np.diff(indptr) - 1
    n_elements = np.diff(by_node[0])
    in_plane = cells.shape[1] == 3
    return np.flatnonzero(n_others == n_elements if in_plane else 2 * n_others == n_elements + 4)


def _add_extrapolated(
    nodal: np.ndarray,
    points: np.ndarray,
    outer: np.ndarray,
    shared: sparse.coo_array,
    inner: np.ndarray,
    fits: np.ndarray,
) -> np.ndarray:
    """Add to the values ``nodal`` of outer nodes the fits a + B (x - x_i) of their inner neighbours i
    there, times the number of elements that both share (``shared`` (n_outer, n_points)); return the sums
    of these numbers (n_points,). All nodes lie at ``points`` (n_points, dim)."""
    fit_of_node = places_of(inner, len(points))
    has_fit = fit_of_node[shared.col] >= 0
    node = outer[shared.row[has_fit]]
    neighbour = shared.col[has_fit]
    n_shared = shared.data[has_fit]
    neighbour_fits = fits[fit_of_node[neighbour]]
    steps = points[node] - points[neighbour]
    values = neighbour_fits[:, 0] + np.einsum("nd,ndc->nc", steps, neighbour_fits[:, 1:])
    np.add.at(nodal, node, n_shared[:, None] * values)
    return np.bincount(node, n_shared, len(points))


def _fits(
    patches: sparse.csr_array, places: np.ndarray, centroids: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return fits a, B (n, dim + 1, n_values) around places (n, dim), and the mask (n,) of the patches
    (n, n_elements) that determine them, of ``values`` (n_elements, n_values) at ``centroids`` (n_elements,
    dim); elsewhere a is the mean, and B has no meaning."""
    first = patches.indptr[:-1]
    rows = np.repeat(np.arange(len(places)), np.diff(patches.indptr))
    offsets = centroids.take(patches.indices, axis=0) - places.take(rows, axis=0)
    extents = np.maximum.reduceat(np.abs(offsets), first).max(axis=1)
    terms = np.ones((len(rows), offsets.shape[1] + 1))
    np.divide(offsets, extents[rows, None], out=terms[:, 1:])
    n = len(places)
    k = terms.shape[1]
    samples = values.take(patches.indices, axis=0)
    # numbers of all nodes side by side
    matrix = np.empty((k, k, n))
    right_sides = np.empty((k, values.shape[1], n))
    determined = np.ones(n, dtype=bool)
    for a in range(k):
        sums = sparse.csr_array(
            (terms[:, a], np.arange(len(terms)), patches.indptr), shape=(n, len(terms))
        )
        # scipy-stubs: of dense arrays
        matrix[a] = cast("np.ndarray", sums @ terms).T
        right_sides[a] = cast("np.ndarray", sums @ samples).T
    means = right_sides[0] / matrix[0, 0]
    # Gauss elimination of all normal equations at the same time. Samples on a line, or in a plane,
    # have pivots below
    limit = checks.SIX_DIGITS * matrix[0, 0]
    for a in range(k):
        determined &= matrix[a, a] > limit
        matrix[a, a, ~determined] = 1.0  # a pivot for fits that are replaced by means
        factor = matrix[a + 1 :, a] / matrix[a, a]
        matrix[a + 1 :] -= factor[:, None] * matrix[a]
        right_sides[a + 1 :] -= factor[:, None] * right_sides[a]
    for a in reversed(range(k)):
        right_sides[a] -= (matrix[a, a + 1 :, None] * right_sides[a + 1 :]).sum(axis=0)
        right_sides[a] /= matrix[a, a]
    right_sides[1:] /= extents  # offsets were over the extents
    right_sides[0] = np.where(determined, right_sides[0], means)
    return right_sides.transpose(2, 0, 1), determined
