r"""The load vector: tractions, body forces and initial strains tested with the P1 shape functions,
and forces at nodes.

.. math:: b_{i} = \int_\Omega f\,\varphi_i + \int_{\Gamma} g\,\varphi_i
   + \int_\Omega C \varepsilon_0 : \varepsilon(\varphi_i), \qquad \sigma = C (\varepsilon - \varepsilon_0)

by quadrature of degree 2 on each element and facet, in axisymmetry, where all is weighted with
:math:`2 \pi r`, of degree 5: exact for data that are linear in position. Initial (stress-free)
strains have principal components along the axes; the third one in two dimensions is through the
thickness or, in axisymmetry, the hoop strain. It matters in plane strain, where the total strain
through the thickness is zero, and in axisymmetry; in plane stress the sheet follows it. Smoothed
elements (:mod:`adaptmg.discrete.elasticity`) take the means of initial strains around edges, as of
strains.

Springs between boundaries or nodes and the ground add to the stiffness matrix, and exert forces:

.. math:: a_s(u, v) = \int_\Gamma k_n\, u_n v_n + k_t\, u_t \cdot v_t \quad\text{or}\quad \sum_i k_i\, u_i v_i
   \text{ at a node}, \qquad t = -k_n u_n n - k_t u_t ,

with the facets' normals n, by the quadrature of loads; in axisymmetry weighted with :math:`2 \pi
r`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast, get_args

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import (
    Tangents,
    element_measures,
    shape_gradients,
    smoothed,
    stiffness,
)
from adaptmg.discrete.moduli import (
    Materials,
    as_tensors,
    body_materials,
    inelastic_bodies,
    is_axisymmetric,
    moduli,
)
from adaptmg.discrete.supports import node_at
from adaptmg.discrete.volumes import formed_volumes, volume_groups
from adaptmg.geometry.quadrature import integration, quadrature_points
from adaptmg.mesh.arrays import MeshArrays, pair_keys
from adaptmg.mesh.soundness import check_mesh
from adaptmg.problem.laws import Elastic, PlaneStress
from adaptmg.problem.loads import (
    AnySupport,
    BodyForce,
    InitialStrain,
    Load,
    PointForce,
    PointSpring,
    Preload,
    Pressure,
    Spring,
    Traction,
)

#: points of each facet at which a load is evaluated that is zero at the quadrature points
_BETWEEN = 32


def load_vector(
    mesh: MeshArrays,
    loads: Sequence[Load],
    material: Materials | None = None,
    elements: str = "linear",
) -> np.ndarray:
    """Return the nodal forces (n_dofs,) of all loads; dual, dof = dim * node + component.

    N (plane: per metre of thickness; axisymmetric: of the full circumference). Functions of
    position are called once each, with all quadrature points (n, dim). Axisymmetric materials
    weight all with 2 pi r; initial strains need the elastic constants, and depend on the
    ``elements``. ValueError for a boundary or body the mesh does not have, components of the wrong
    number, data that are not finite, or an initial strain without ``material``.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> force = am.discrete.load_vector(mesh, [am.Pressure("top", 2e6)])
    >>> force.reshape(-1, 2).sum(axis=0).tolist()                                  # N/m
    [0.0, -2000000.0]
    """
    materials = None if material is None else body_materials(mesh, material)
    axisymmetric = materials is not None and is_axisymmetric(materials)
    vector = np.zeros(check_mesh(mesh).points.size)
    checks.choice("elements", elements, ("linear", "smoothed"))
    result = vector.reshape(mesh.points.shape)  # a view: what is added to it is in ``vector``
    for load in checks.items("loads", loads, get_args(Load), "Pressure, Traction, BodyForce, ..."):
        if isinstance(load, InitialStrain):
            if materials is None:
                raise ValueError(
                    f"the load of {load!r} depends on the elastic constants: give material"
                )
            result += initial_strain_load(mesh, load, materials, elements)
        elif isinstance(load, Preload):
            continue  # its strain is to be found (:mod:`adaptmg.evolution.load_steps`)
        elif isinstance(load, PointForce):
            result[node_at(mesh, load.point, load.body)] += load.components
        elif isinstance(load, BodyForce):
            rows = slice(None) if load.body is None else body_elements(mesh, load.body)
            _add(result, mesh, mesh.elements[rows], mesh.volumes[rows], load, axisymmetric)
        else:
            surface = mesh.surface(load.boundary)
            _add(
                result, mesh, surface.facets, surface.measures, load, axisymmetric, surface.normals
            )
    return vector


def _add(
    result: np.ndarray,
    mesh: MeshArrays,
    cells: np.ndarray,
    measures: np.ndarray,
    load: BodyForce | Pressure | Traction,
    axisymmetric: bool,
    normals: np.ndarray | None = None,
) -> None:
    """Add the nodal forces of one load on ``cells`` (n, n_corners), elements or facets with these
    ``measures`` (n,), to ``result`` (n_nodes, dim), N; facets have outward unit ``normals`` (n, dim)."""
    rule, points, weights = integration(mesh.points, cells, measures, axisymmetric)
    forces = weights[:, :, None] * load_density(load, points, normals)
    np.add.at(result, cells, rule.T @ forces)


def check_loads(mesh: MeshArrays, loads: Sequence[Load]) -> None:
    """Raise ValueError for a pressure or traction, a function of position, that is zero at all
    quadrature points but not between them: it acts on less than a facet, and its integral is 0."""
    for load in loads:
        if not isinstance(load, Pressure | Traction):
            continue
        if not any(map(callable, (load.value,) if isinstance(load, Pressure) else load.components)):
            continue
        surface = mesh.surface(load.boundary)
        corners = mesh.points[surface.facets]
        _, points, _ = integration(
            mesh.points, surface.facets, surface.measures, axisymmetric=False
        )
        # further points, at random places of each facet
        barycentric = np.random.default_rng(0).dirichlet(np.ones(mesh.dim), _BETWEEN)
        between_points = np.einsum("sk,fkd->fsd", barycentric, corners)
        acts_where_integrated, acts_between = (
            load_density(load, at, surface.normals).any() for at in (points, between_points)
        )
        if acts_between and not acts_where_integrated:
            edge = np.ptp(corners, axis=1).max()
            raise ValueError(
                f"the {type(load).__name__} on {load.boundary!r} acts on less than an edge ({edge:.3g} m) "
                "and integrates to 0: take a finer mesh there, or make that part a boundary of its own"
            )


def load_density(
    load: BodyForce | Pressure | Traction, points: np.ndarray, normals: np.ndarray | None
) -> np.ndarray:
    """Return the force per volume or area at points (n_cells, n_quadrature, dim), in the same
    shape; a pressure acts against the outward unit ``normals`` (n_cells, dim) of facets."""
    shape = points.shape[:2]
    dim = points.shape[2]
    flat = points.reshape(-1, dim)
    if isinstance(load, Pressure):
        value = checks.field(f"pressure on {load.boundary!r}", load.value, flat).reshape(shape)
        # on surfaces, which have normals
        return -value[:, :, None] * cast("np.ndarray", normals)[:, None, :]
    if len(load.components) != dim:
        raise ValueError(f"{load!r} has {len(load.components)} components on a {dim}D mesh")
    named = f"{type(load).__name__} on {load.place!r}"
    return np.stack(
        [
            checks.field(f"component {'xyz'[k]} of {named}", component, flat).reshape(shape)
            for k, component in enumerate(load.components)
        ],
        axis=-1,
    )


def body_elements(mesh: MeshArrays, body: str) -> np.ndarray:
    """Return the ascending element numbers of a body; ValueError if it does not exist."""
    if body not in mesh.bodies:
        raise ValueError(f"body {body!r} does not exist; the bodies are {', '.join(mesh.bodies)}")
    return np.flatnonzero(mesh.element_body == mesh.bodies.index(body))


def mean_initial_strain(
    mesh: MeshArrays, loads: Sequence[Load], *, axisymmetric: bool = False
) -> np.ndarray:
    """Return the mean (n_elements, 3) of the sum of all initial strains on each element: components
    along the axes, in the plane the third one as in the module."""
    result = np.zeros((len(mesh.elements), 3))
    for load in loads:
        if isinstance(load, InitialStrain):
            elements, strain, weights, _ = _at_quadrature_points(mesh, load, axisymmetric)
            result[elements] += (
                np.einsum("eq,eqd->ed", weights, strain) / weights.sum(axis=1)[:, None]
            )
    return result


def initial_strain_load(
    mesh: MeshArrays, load: InitialStrain, materials: tuple[Elastic, ...], elements: str
) -> np.ndarray:
    """Return the nodal forces (n_nodes, dim) of an initial strain: int C eps_0 : eps(phi_i)."""
    axisymmetric = is_axisymmetric(materials)
    at_points = _mean_around_edges if elements == "smoothed" else _at_quadrature_points
    elements_of_body, strain, weights, rule = at_points(mesh, load, axisymmetric)
    if isinstance(materials[mesh.bodies.index(load.body)], PlaneStress):
        # a sheet is free to become thicker
        strain[:, :, 2] = 0.0
    # C eps_0 as columns (n, n_points, k), then as tensors (n, n_points, 3, 3)
    tensors = moduli(mesh, materials, elements)
    stress_columns = np.einsum(
        "eij,eqj->eqi", tensors.table[tensors.rows[elements_of_body], :, :3], strain
    )
    stress = as_tensors(stress_columns.reshape(-1, stress_columns.shape[2])).reshape(
        *stress_columns.shape[:2], 3, 3
    )
    # forces (n, dim + 1, dim) at the corners of elements, by the stress integrated over each element
    cells = mesh.elements[elements_of_body]
    dim = mesh.dim
    integrated = np.einsum("eq,eqij->eij", weights, stress[:, :, :dim, :dim])
    forces = shape_gradients(mesh)[0][elements_of_body] @ integrated
    if axisymmetric:
        # the hoop strain of phi_i along r is phi_i / r
        radii = quadrature_points(mesh.points, cells, rule)[:, :, 0]
        forces[:, :, 0] += np.einsum("eq,qc->ec", weights * stress[:, :, 2, 2] / radii, rule)
    result = np.zeros(mesh.points.shape)
    np.add.at(result, cells, forces)
    return result


def _at_quadrature_points(
    mesh: MeshArrays, load: InitialStrain, axisymmetric: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the elements (n,) of an initial strain, the strain (n, n_quadrature, 3) there, the
    quadrature weights (n, n_quadrature), and the barycentric points (n_quadrature, dim + 1)."""
    n = len(load.components)
    if n not in (mesh.dim, 3):
        raise ValueError(
            f"{load!r} has {n} components on a {mesh.dim}D mesh: "
            + ("give 3" if mesh.dim == 3 else "give 2, or 3 with the one out of the plane")
        )
    elements = body_elements(mesh, load.body)
    rule, points, weights = integration(
        mesh.points, mesh.elements[elements], mesh.volumes[elements], axisymmetric
    )
    strain = np.zeros((*points.shape[:2], 3))
    for d, component in enumerate(load.components):
        name = f"component {d + 1} of InitialStrain on {load.body!r}"
        strain[:, :, d] = checks.field(name, component, points.reshape(-1, mesh.dim)).reshape(
            points.shape[:2]
        )
    return elements, strain, weights, rule


def _mean_around_edges(
    mesh: MeshArrays, load: InitialStrain, axisymmetric: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the arrays of :func:`_at_quadrature_points` for smoothed elements: their only point is the
    centroid, with the mean strain around the edges of the element."""
    elements = body_elements(mesh, load.body)
    volumes = element_measures(mesh, axisymmetric)
    mean = mean_initial_strain(mesh, [load], axisymmetric=axisymmetric)
    strain = smoothed(mesh, mean, volumes)[elements, None]
    centroid = np.full((1, mesh.dim + 1), 1 / (mesh.dim + 1))
    return elements, strain, volumes[elements, None], centroid


def foundation(spring: Spring, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return stiffness per area (n_facets, n_points, dim, dim), N/m^3, at ``points`` (n_facets, n_points,
    dim) of facets with the unit ``normals`` (n_facets, dim)."""
    flat = points.reshape(-1, points.shape[2])
    normal, tangential = (
        checks.field(
            f"{name} of the spring on {spring.boundary!r}", getattr(spring, name), flat
        ).reshape(points.shape[:2])
        for name in ("normal", "tangential")
    )
    for name, values in (("normal", normal), ("tangential", tangential)):
        if values.min(initial=0.0) < 0:
            raise ValueError(
                f"{name} of the spring on {spring.boundary!r} must be >= 0, got {values.min():g} N/m^3"
            )
    # k_n n n' + k_t (I - n n')
    outer = np.einsum("fi,fj->fij", normals, normals)[:, None]
    return normal[:, :, None, None] * outer + tangential[:, :, None, None] * (
        np.eye(normals.shape[1]) - outer
    )


def spring_elements(
    mesh: MeshArrays, spring: Spring | PointSpring, axisymmetric: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (n, k) of the facets on which a spring acts, or the one node of a point spring,
    and the stiffness (n, k, k, dim, dim) between the nodes of each, N/m."""
    if isinstance(spring, PointSpring):
        point_stiffness = np.diag([spring.x, spring.y, spring.z][: mesh.dim])
        return np.array([[node_at(mesh, spring.point, spring.body)]]), point_stiffness[
            None, None, None
        ]
    surface = mesh.surface(spring.boundary)
    rule, points, weights = integration(mesh.points, surface.facets, surface.measures, axisymmetric)
    per_area = weights[:, :, None, None] * foundation(spring, points, surface.normals)
    # int phi_a phi_b k: the products of shape functions are symmetric to the last bit, and so is the
    # matrix
    return surface.facets, np.einsum(
        "qab,fqij->fabij", rule[:, :, None] * rule[:, None, :], per_area
    )


def supported_stiffness(
    mesh: MeshArrays,
    material: Materials,
    supports: Sequence[AnySupport],
    elements: str = "linear",
    tangents: Tangents | None = None,
) -> sparse.bsr_array:
    """Return the stiffness of the bodies, of plastic ones with the volumes of their groups of
    nodes, and of the springs that hold them, as :func:`adaptmg.discrete.stiffness`."""
    matrix = stiffness(mesh, material, elements, tangents)
    materials = body_materials(mesh, material)
    if elements == "smoothed" and inelastic_bodies(materials).any():
        volumes = (
            formed_volumes(volume_groups(mesh, materials, inelastic=True), mesh.dim)
            if tangents is None
            else tangents.volumes
        )
        matrix = sparse.bsr_array(matrix + volumes).sorted_indices()
    springs = [support for support in supports if isinstance(support, Spring | PointSpring)]
    if springs:
        # ascending, as the columns of each row are: the place of a key is that of its block
        block_rows = np.repeat(np.arange(mesh.n_nodes), np.diff(matrix.indptr))
        keys = pair_keys(block_rows, matrix.indices, mesh.n_nodes)
    for spring in springs:
        cells, blocks = spring_elements(mesh, spring, is_axisymmetric(material))
        spring_keys = pair_keys(cells[:, :, None], cells[:, None, :], mesh.n_nodes)
        np.add.at(
            matrix.data,
            np.searchsorted(keys, spring_keys.ravel()),
            blocks.reshape(-1, mesh.dim, mesh.dim),
        )
    return matrix


def largest_nodal_stiffness(
    mesh: MeshArrays, spring: Spring | PointSpring, axisymmetric: bool
) -> float:
    """Return the largest force, N/m, by which a spring resists at one node a translation of its boundary
    by 1 along an axis."""
    cells, blocks = spring_elements(mesh, spring, axisymmetric)
    # forces[i, a]: at node i, of a translation along a, as the blocks are symmetric
    forces = np.zeros((mesh.n_nodes, mesh.dim, mesh.dim))
    np.add.at(forces, cells, blocks.sum(axis=2))
    return float(np.linalg.norm(forces, axis=2).max())


def spring_resultants(
    mesh: MeshArrays, supports: Sequence[AnySupport], displacement: np.ndarray, axisymmetric: bool
) -> dict[str, list[float]]:
    """Return by place the components of the force that springs exert on the bodies at a displacement
    (n_nodes, dim), N, followed by those of its moment about the origin, N m."""
    result: dict[str, list[float]] = {}
    for spring in (support for support in supports if isinstance(support, Spring | PointSpring)):
        cells, blocks = spring_elements(mesh, spring, axisymmetric)
        forces = -np.einsum("fabij,fbj->fai", blocks, displacement[cells]).reshape(-1, mesh.dim)
        resultant = [*forces.sum(axis=0), *moment(mesh.points[cells].reshape(forces.shape), forces)]
        result[spring.place] = (np.array(resultant) + result.get(spring.place, 0.0)).tolist()
    return result


def moment(arms: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the sum of the moments of forces (n, dim) with arms (n, dim): 2D (1,), 3D (3,)."""
    moments = (
        np.cross(arms, forces)
        if arms.shape[1] == 3
        else arms[:, :1] * forces[:, 1:] - arms[:, 1:] * forces[:, :1]
    )
    return moments.sum(axis=0)
