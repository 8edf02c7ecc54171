"""Posed: a result with the problem, mesh and matrix it belongs to, checked before anything is estimated from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.discretisation.body_materials import body_materials
from adaptmg.discretisation.loads import load_vector
from adaptmg.discretisation.measures import StressData
from adaptmg.estimate.fields.element_stress import ElementStress, element_stress
from adaptmg.estimate.fields.neighbours import Neighbours, neighbours
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.solver.result import Result
from adaptmg.solver.sizes import energy_norm, euclidean_norm

__all__ = ["Posed", "posed"]

_LOADS_AGREE = 1e-6  # relative; the result's are known to rounding
_ROUNDING = 1e-13  # of A u, over the diagonal times u: bodies that their supports move strain no element


@dataclass(frozen=True, eq=False)
class Posed:
    """What a result solves.

    Attributes
    ----------
    problem : ContactProblem
    mesh : MeshArrays
    discrete : DiscreteProblem
    result : Result
    """

    problem: ContactProblem
    mesh: MeshArrays
    discrete: DiscreteProblem
    result: Result

    @cached_property
    def stress(self) -> ElementStress:
        """Stress on each element."""
        data = self.result.stress_data
        if data is None:
            data = StressData.of(self.mesh, self.problem.material, self.problem.loads)
        return element_stress(self.mesh, self.result.displacement, data)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Who lies beside whom."""
        return neighbours(self.mesh)

    @cached_property
    def young(self) -> np.ndarray:
        """Young's modulus of each element (n_elements,), Pa."""
        of_bodies = np.array([one.young for one in body_materials(self.mesh, self.problem.material)])
        return of_bodies[self.mesh.element_body]

    @cached_property
    def norm(self) -> float:
        """||u_h||_A, sqrt(N m): of displacements, prescribed ones included."""
        return energy_norm(*self._moved)

    @cached_property
    def _moved(self) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and the forces A u (n_dofs,), between bodies relative."""
        unknowns = self.discrete.relative(self.result.displacement).reshape(-1)
        return unknowns, self.discrete.matrix @ unknowns

    def check_loads(self) -> None:
        """ValueError unless the loads of the problem are those under which the result was found.

        The result says under which: b = A u - (reactions and contact forces).
        """
        coupling, (unknowns, forces) = self.discrete.coupling, self._moved
        exerted = np.asarray(self.result.reaction, dtype=np.float64).reshape(-1)
        if exerted.shape != forces.shape:
            raise ValueError(f"result.reaction must have {forces.size} components, got {exerted.shape}")
        load = forces - (exerted if coupling is None else coupling.relative_forces(exerted))
        rounding = _ROUNDING * euclidean_norm(self.discrete.matrix.diagonal() * unknowns)
        allowed = max(_LOADS_AGREE * max(euclidean_norm(forces), euclidean_norm(load)), rounding)
        if euclidean_norm(load - self.discrete.load) <= allowed:
            return
        posed = load_vector(self.mesh, self.problem.loads, self.problem.material)
        posed = posed if coupling is None else coupling.relative_forces(posed)
        if not euclidean_norm(load - posed) <= allowed:
            raise ValueError("result was found under other loads than those of hierarchy.problem: for step k of a load "
                             "path give dataclasses.replace(hierarchy, problem=step_problem(problem, factors)) with "
                             "the factors of the step (adaptmg.problem.step_problem)")


def posed(hierarchy: Hierarchy, result: Result) -> Posed:
    """Checked to belong together.

    Parameters
    ----------
    hierarchy : Hierarchy
        Of a ContactProblem; its finest mesh counts.
    result : Result
        Of :func:`adaptmg.solve` on it.

    Raises
    ------
    TypeError
        On other things.
    ValueError
        Without a problem or mesh, of a result of another mesh or found under other loads, or one with values that are
        not finite.
    """
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy")
    checks.instance("result", result, Result, "a Result")
    mesh, discrete = hierarchy.finest.mesh, hierarchy.finest.discrete
    if hierarchy.problem is None or mesh is None:
        raise ValueError("hierarchy has no ContactProblem or no mesh (it comes from matrices): loads, materials and "
                         "elements are needed to estimate an error; make it by Hierarchy.uniform, graded or "
                         "from_meshes")
    if result.mesh is None:
        raise ValueError("result has no mesh (it comes from a bare DiscreteProblem): solve on a Hierarchy of a "
                         "ContactProblem")
    own = result.mesh
    if own is not mesh and not (own.points.shape == mesh.points.shape and own.elements.shape == mesh.elements.shape
                                and np.array_equal(own.elements, mesh.elements)
                                and np.array_equal(own.points, mesh.points)):
        raise ValueError(f"result is of another mesh ({own.n_nodes} nodes) than the finest of hierarchy "
                         f"({mesh.n_nodes} nodes): give the hierarchy it was solved on, or hierarchy.truncated(...)")
    if not np.isfinite(result.displacement).all():
        i = int(np.argmin(np.isfinite(result.displacement).all(axis=1)))
        raise ValueError(f"result.displacement must be finite, got {result.displacement[i]} at node {i}: the solver "
                         f"ended with {result.status.name}")
    this = Posed(hierarchy.problem, mesh, discrete, result)
    this.check_loads()
    return this
