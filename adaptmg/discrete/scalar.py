r"""ScalarProblem: problems with one unknown a node, such as a membrane between obstacles, on meshes
of the package.

.. math:: -\nabla\cdot(k\,\nabla u) = f,\qquad l \le u \le h,

with u given on a part of the boundary and limits at the nodes, by linear elements, with equality
where no limit is met. For a membrane k is its tension (N/m), f a pressure and u a deflection; for
Prandtl's stress function of a twisted bar u is bounded by the yield stress in shear times the
distance to the boundary. Elsewhere on the boundary no flux enters. The obstacle acts by nodal
forces; over the lumped masses :math:`\int\varphi_i` they are pressures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import html_fields
from adaptmg.discrete.contact_nodes import Bounds
from adaptmg.discrete.elasticity import shape_gradients
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.geometry.quadrature import integration
from adaptmg.mesh.arrays import MeshArrays, centroids
from adaptmg.problem.plane_domains import Domain


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ScalarProblem(checks.Checked):
    """A scalar problem between obstacles, for hierarchies of meshes and :func:`adaptmg.adapt`.

    Parameters
    ----------
    domain : Domain, optional
        The domain to mesh; meshes may be given instead.
    conductivity : float or callable
        k > 0, number or function of position, taken at the centroids of elements.
    load : float or callable
        f per area (3D: volume), number or function of position.
    lower, upper : float or callable, optional
        Limits of u at the nodes, finite numbers or functions of position; None: no limit. Where an
        obstacle covers a part of the domain only, the limit elsewhere is one that u does not reach.
    held : sequence of str, optional
        Boundaries where u is prescribed; default all.
    value : float or callable
        Prescribed u on these boundaries.
    name : str
    reference : mapping
        Known quantities of the solution, for cases.

    Examples
    --------
    >>> membrane = am.ScalarProblem(domain=am.Rectangle(width=1.0, height=1.0), load=-1.0, lower=-0.05)
    >>> grids = am.Hierarchy.uniform(membrane, divisions=(4, 8, 16))
    >>> round(float(am.solve(grids).displacement.min()), 3)
    -0.05
    """

    domain: Annotated[Domain, partial(checks.instance, types=Domain)] | None = None
    conductivity: Annotated[
        checks.FieldLike,
        partial(checks.function_or, check=partial(checks.quantity, positive=True)),
    ] = 1.0
    load: checks.Value = 0.0
    lower: checks.Value | None = None
    upper: checks.Value | None = None
    held: Annotated[tuple[str, ...], checks.strings] | None = None
    value: checks.Value = 0.0
    name: checks.Name = "scalar problem"
    reference: Annotated[Mapping[str, Any], partial(checks.mapping, words="names to values")] = (
        field(default_factory=dict)
    )

    # bodies have these, and code that meshes and solves both reads them
    contact: ClassVar[tuple[()]] = ()
    supports: ClassVar[tuple[()]] = ()
    loads: ClassVar[tuple[()]] = ()
    pair_boundaries: ClassVar[tuple[str, ...]] = ()
    tied_boundaries: ClassVar[tuple[str, ...]] = ()

    _repr_html_ = html_fields

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.domain is not None and self.domain.boundaries is not None:
            for boundary in self.held or ():
                checks.choice("held", boundary, self.domain.boundaries)

    def conductivity_on(self, mesh: MeshArrays) -> np.ndarray:
        """Return the conductivity (n_elements,) at the centroids of elements."""
        places = centroids(mesh.points, mesh.elements)
        k = checks.field("conductivity", self.conductivity, places)
        if not (k > 0).all():
            raise ValueError(f"conductivity must be > 0, got {k.min():.6g}")
        return k

    def limits_at(self, points: np.ndarray) -> np.ndarray:
        """Return the lower and the upper limit (2, n) at points (n, dim), infinite where there is
        none."""
        return np.stack(
            [
                np.full(len(points), none) if limit is None else checks.field(name, limit, points)
                for name, limit, none in (
                    ("lower", self.lower, -np.inf),
                    ("upper", self.upper, np.inf),
                )
            ]
        )

    def on(self, mesh: MeshArrays) -> DiscreteProblem:
        """Return the problem discretised on a mesh of triangles or tetrahedra.

        ValueError for boundaries that the mesh does not have, a conductivity that is not positive,
        and limits that leave no room."""
        checks.instance("mesh", mesh, MeshArrays, "MeshArrays")
        fixed = np.zeros(mesh.n_nodes, dtype=bool)
        for boundary in mesh.boundaries if self.held is None else self.held:
            fixed[mesh.boundary_nodes(boundary)] = True
        values = np.zeros(mesh.n_nodes)
        values[fixed] = checks.field("value", self.value, mesh.points[fixed])
        lower, upper = self.limits_at(mesh.points)
        for name, excess in (("lower", lower - values), ("upper", values - upper)):
            beyond = excess[fixed]
            if beyond.max(initial=0.0) > 0.0:
                raise ValueError(
                    f"{name} must leave the values of held boundaries room, but one lies {beyond.max():.6g} beyond it"
                )
        # int phi_i
        corners = np.repeat(mesh.volumes / (mesh.dim + 1), mesh.dim + 1)
        masses = np.bincount(mesh.elements.reshape(-1), corners)
        return DiscreteProblem(
            matrix=self._stiffness(mesh),
            load=self._load(mesh),
            fixed=fixed,
            fixed_values=values,
            bounds=Bounds(lower=lower, upper=upper, weights=masses),
            coordinates=mesh.points,
            name=f"{self.name}, {mesh.n_nodes} nodes",
        )

    def _stiffness(self, mesh: MeshArrays) -> sparse.csr_array:
        """Return the matrix (n_nodes, n_nodes) of the conductivity."""
        slopes, measures = shape_gradients(mesh)
        # k grad phi_a . grad phi_b on each element
        entries = (self.conductivity_on(mesh) * measures)[:, None, None] * (
            slopes @ slopes.swapaxes(1, 2)
        )
        row = np.broadcast_to(mesh.elements[:, :, None], entries.shape).reshape(-1)
        column = np.broadcast_to(mesh.elements[:, None], entries.shape).reshape(-1)
        shape = (mesh.n_nodes, mesh.n_nodes)
        # entries that vanish stay: coarse matrices have them
        return sparse.coo_array((entries.reshape(-1), (row, column)), shape=shape).tocsr()

    def _load(self, mesh: MeshArrays) -> np.ndarray:
        """Return the nodal loads (n_nodes,)."""
        rule, points, weights = integration(
            mesh.points, mesh.elements, mesh.volumes, axisymmetric=False
        )
        density = checks.field("load", self.load, points.reshape(-1, mesh.dim))
        forces = (weights * density.reshape(weights.shape)) @ rule
        return np.bincount(mesh.elements.reshape(-1), forces.reshape(-1))
