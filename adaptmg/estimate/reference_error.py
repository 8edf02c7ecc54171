r"""The energy error of a discrete solution against a reference on another, finer mesh, without
interpolating it there.

.. math:: \|u - u_h\|^2 = \|u\|^2 - 2\,a(u, u_h) + \|u_h\|^2,\qquad
   a(u, v) = b(v) + \sum_i R_i \cdot v(x_i)

with the load b and the nodal forces R that contact (on slaves and masters) and supports exert on
the reference: u_h is needed only at the nodes that have such forces, and in b on its own mesh,
where it is exact. The interpolant of u_h in the reference's mesh would have another energy wherever
elements overlap.

For u stands the reference :math:`u_H`. By Galerkin orthogonality (exact for nested spaces without
contact)
:math:`\|u - u_h\|^2 \approx \|u_H - u_h\|^2 + \|u - u_H\|^2`, so that the reference's own error is added; unless it is
given it is estimated by :class:`~adaptmg.estimate.estimate.Recovery`. Measured on exact solutions
the result is right to .4 times the square of the quotient of both errors: 2 % against a reference
of four times less error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_vector, supported_stiffness
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.estimate.estimate import Recovery
from adaptmg.estimate.stress_fields import solved
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import need_mesh
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.solver.result import Result
from adaptmg.transfer.interpolation import PointLocator, nodes_of_bodies

#: of the energy, by how much its differences may be negative: the patch test with a slope of 20 degrees, solved
#: twice to 1e-7 and 1e-8, leaves 3.1e-9
_RESOLVED = 1e-8


@dataclass(frozen=True)
class EnergyError:
    """An error in the energy norm. Its figures are not more accurate than ``allowance``, which should
    be well below."""

    absolute: float  # ||u - u_h||, sqrt(N m)
    relative: float  # the same over ||u||
    norm: float  # ||u||, sqrt(N m)
    allowance: float  # the reference's own error, which is contained in absolute, sqrt(N m)


@dataclass(frozen=True, eq=False)
class Reference:
    """A solution that errors are measured against; made once, by :meth:`of`. Mappings are by the
    name of the body."""

    problem: ContactProblem
    energy: float  # ||u_H||^2, N m
    own_error: float  # ||u - u_H|| by Recovery, sqrt(N m)
    #: (n, dim): points at which contact or supports exert forces, m
    points: Mapping[str, np.ndarray] = field(repr=False)
    #: (n, dim): these forces, on the body, N
    forces: Mapping[str, np.ndarray] = field(repr=False)
    #: (n, dim): constant displacements that supports prescribe there, m; NaN elsewhere
    prescribed: Mapping[str, np.ndarray] = field(repr=False)

    @classmethod
    def of(cls, hierarchy: Hierarchy, result: Result) -> Reference:
        """Return the reference made of a result on the finest mesh of a hierarchy, solved far below the errors to
        be measured."""
        state = solved(hierarchy, result)
        if state.problem.elements == "smoothed":
            raise ValueError(
                "a reference must have linear elements, whose energy is that of their strains: solve "
                'dataclasses.replace(problem, elements="linear")'
            )
        mesh = state.mesh
        forces = _exerted(state.discrete, result)
        prescribed = _constants(state.posed)
        acting = np.abs(forces).max(axis=1) > checks.ROUNDING * np.abs(forces).max()
        owner = nodes_of_bodies(mesh, "hierarchy")
        # just inside one of the elements at each node: the faces of a crack lie at one place
        inside = np.empty(mesh.points.shape)
        inside[mesh.elements] = mesh.points[mesh.elements].mean(axis=1, keepdims=True)
        places = mesh.points + checks.ALIKE * (inside - mesh.points)
        loaded = {body: np.flatnonzero(acting & (owner == k)) for k, body in enumerate(mesh.bodies)}
        return cls(
            state.problem,
            energy=state.norm**2,
            own_error=Recovery().indicate(hierarchy, result).total,
            points={body: places[nodes] for body, nodes in loaded.items()},
            forces={body: forces[nodes] for body, nodes in loaded.items()},
            prescribed={body: prescribed[nodes] for body, nodes in loaded.items()},
        )

    def against(self, result: Result) -> float:
        """Return a(u, u_h) of a result, N m."""
        mesh = need_mesh(result)
        u = result.displacement
        # the work of loads, contact and supports on u_h
        product = float(
            load_vector(mesh, self.problem.loads, self.problem.material) @ u.reshape(-1)
        )
        for body, points in self.points.items():
            if len(points):
                # points of curved surfaces may lie outside this mesh: there the nearest place counts
                place = PointLocator(mesh, mesh.bodies.index(body)).locate(points)
                moved = np.einsum("nk,nkd->nd", place.weights, u[mesh.elements[place.element]])
                moved = np.where(np.isnan(self.prescribed[body]), moved, self.prescribed[body])
                product += float(np.sum(self.forces[body] * moved))
        return product


def energy_error(reference: Reference | tuple[Hierarchy, Result], result: Result) -> EnergyError:
    """Return the error of a result in the energy norm.

    The strains are those of each element, also where the elements are smoothed. As a difference of
    energies it does not resolve errors below 1e-4 of the norm, where it may be 0. ValueError
    without a mesh, for other bodies, or where the squared error comes out negative.

    Parameters
    ----------
    reference : Reference, or (Hierarchy, Result)
        On a mesh 4 to 8 times finer; a Reference made once serves many results. ValueError for
        smoothed elements, whose energy is not that of the strains of elements: solve the reference
        with linear ones.
    result : Result
        Of the same problem, on any mesh of the same domain with the same names. On curved
        boundaries the domains of two meshes differ, which counts as error too: on a pin with a
        fillet in 3D, 2 800 nodes, a quarter of it.

    Examples
    --------
    >>> bar = am.cases.greco_bar()
    >>> fine = am.Hierarchy.uniform(bar, divisions=(4, 8, 16))
    >>> coarse = am.solve(am.Hierarchy.uniform(bar, divisions=(2, 4)))
    >>> error = am.estimate.energy_error((fine, am.solve(fine)), coarse)
    >>> 0.05 < error.relative < 0.5
    True
    """
    if isinstance(reference, tuple) and len(reference) == 2:
        reference = Reference.of(*reference)
    checks.instance(
        "reference", reference, Reference, "a Reference, or a hierarchy and a result on it"
    )
    checks.instance("result", result, Result, "a Result")
    mesh = need_mesh(result)
    if set(mesh.bodies) != set(reference.points):
        raise ValueError(
            f"result has the bodies {', '.join(mesh.bodies)}, the reference "
            f"{', '.join(reference.points)}: give results of one problem"
        )
    reference.problem.check_boundaries(mesh.boundaries)
    u = result.displacement.reshape(-1)
    posed_by = reference.problem
    result_energy = float(u @ (supported_stiffness(mesh, posed_by.material, posed_by.supports) @ u))
    # |u - u_h|^2 = |u_H|^2 - 2 a(u, u_h) + |u_h|^2 + |u - u_H|^2
    squared = (
        reference.energy - 2 * reference.against(result) + result_energy + reference.own_error**2
    )
    # a difference of energies is not resolved below this
    if -_RESOLVED * reference.energy <= squared < 0:
        squared = 0.0
    if not squared >= 0:
        raise ValueError(
            f"the squared error comes out as {squared:.3g} N m, that of the reference as "
            f"{reference.own_error**2:.3g}: the reference must be several times finer than the result, "
            "and solved far below the error to be measured"
        )
    norm = float(np.sqrt(reference.energy))
    return EnergyError(
        absolute=float(np.sqrt(squared)),
        relative=float(np.sqrt(squared)) / norm if norm > 0 else np.inf,
        norm=norm,
        allowance=reference.own_error,
    )


def _exerted(discrete: DiscreteProblem, result: Result) -> np.ndarray:
    """Return the forces (n_nodes, dim), N, that contact and supports exert on the bodies. The residual
    of the solver at other nodes is left out, and so are the forces of ties, which do next to no work
    on displacements that obey them."""
    contact = result.contact
    forces = np.zeros_like(result.reaction)
    forces[contact.node] = contact.force
    np.add.at(forces, contact.master_node, contact.master_force)
    # at a node with both, the reaction contains what contact and support exert together
    return forces + discrete.supported_part(result.reaction - forces)


def _constants(posed: Posed) -> np.ndarray:
    """Return the prescribed displacements (n_nodes, dim), m, that are constant along a boundary, and so
    the same on all meshes; NaN elsewhere, as each mesh interpolates a function of position in its own
    way."""
    result = np.full(posed.mesh.points.shape, np.nan)
    for hold in posed.holds:
        if hold.axis is not None and hold.constant:
            result[hold.nodes, hold.axis] = hold.values
    return result
