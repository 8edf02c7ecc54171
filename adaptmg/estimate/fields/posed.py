"""Posed: a result with the problem, mesh and matrix it belongs to, checked before anything is estimated from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.discretisation.body_materials import body_materials
from adaptmg.discretisation.measures import StressData
from adaptmg.estimate.fields.element_stress import ElementStress, element_stress
from adaptmg.estimate.fields.neighbours import Neighbours, neighbours
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.solver.result import Result
from adaptmg.solver.sizes import displacement_norm

__all__ = ["Posed", "posed"]


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
        return displacement_norm(self.discrete, self.discrete.relative(self.result.displacement))


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
        Without a problem or mesh, of a result of another mesh, or one with values that are not finite.
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
    return Posed(hierarchy.problem, mesh, discrete, result)
