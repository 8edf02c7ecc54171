r"""Load steps have nodal loads and prescribed displacements by name, so that every step is a
combination of them:

.. math:: b_k = \sum_j \lambda_{kj}\, b_j, \qquad u_{\mathrm{fixed},k} = \lambda_{kj}\, u_{\mathrm{fixed},j}
   \text{ on support } j .
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem, EnergyTerms
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.supports import Held
from adaptmg.problem.load_path import DEFAULT
from adaptmg.problem.loads import InitialStrain, Preload


@dataclass(frozen=True, eq=False)
class LoadSteps:
    """Loads and prescribed displacements of one mesh, by the names that a load path knows. The ``factors``
    of its methods are the lambda_kj of a step k by these names j; preloads have strains."""

    n_dofs: int
    loads: Mapping[str, np.ndarray]  # dict of str to (n_dofs,), N, in the unknowns of the problem
    # dict of str to ((n,) int, (n,)): dofs and parts of their values, m, which add up
    prescribed: Mapping[str, tuple[np.ndarray, np.ndarray]]
    holds: Sequence[Held] = ()  # what supports hold: they must agree at common nodes
    # stress data without initial strains; Any: None without a problem, which then has no strains
    stress: StressData | Any = None
    # dict of str to (n_elements, 3): initial strains along the axes, means over elements
    strains: Mapping[str, np.ndarray] = field(default_factory=dict)
    # dict of str to (n_dofs,): the parts of ``loads`` that come from initial strains, for energies
    strain_loads: Mapping[str, np.ndarray] = field(default_factory=dict)
    # Any: None without a problem, which has neither strains nor gaps that depend on supports
    posed: Posed | Any = None

    def stress_data(self, factors: Mapping[str, float]) -> StressData | Any:
        """Return the stress data of a step, with its initial strains; None without a problem."""
        if not self.strains:
            return self.stress
        return replace(
            self.stress,
            initial_strain=sum(factors[name] * strain for name, strain in self.strains.items()),
        )

    def step(
        self,
        discrete: DiscreteProblem,
        factors: Mapping[str, float],
        slip_reference: np.ndarray,
        accumulated_slip: np.ndarray,
    ) -> DiscreteProblem:
        """Return the problem of a load step; slips count from ``slip_reference`` (n_contact, dim),
        and come after ``accumulated_slip`` (n_contact,), m."""
        volumes = discrete.volumes
        if self.strains:
            data = self.stress_data(factors)
            volumes = volumes.expanding(self.posed.mesh, data.initial_strain, data.axisymmetric)
        fixed_values = self.fixed_values(factors)
        gaps = None
        change = fixed_values - discrete.fixed_values
        # where supports rest, prescribed values and gaps stay: computing the gaps takes 4 % of a path of 20
        # steps with 4225 nodes
        if not change.any():
            fixed_values = None
        elif self.posed is not None:
            approached = self.posed.approached(change.reshape(discrete.n_nodes, -1))
            gaps = discrete.contact.gaps - approached
        return discrete.with_step(
            load=self.load(factors),
            fixed_values=fixed_values,
            gaps=gaps,
            slip_reference=slip_reference,
            accumulated_slip=accumulated_slip,
            strain_free=self.strain_free(factors),
            volumes=volumes,
        )

    def strain_free(self, factors: Mapping[str, float]) -> EnergyTerms | None:
        """Return the energy terms of the initial strains of a step; None without initial strains."""
        if not self.strains:
            return None
        load = sum(
            (factors[name] * load for name, load in self.strain_loads.items()),
            np.zeros(self.n_dofs),
        )
        return EnergyTerms(load, self.stress_data(factors).suppressed(self.posed.mesh))

    def load(self, factors: Mapping[str, float]) -> np.ndarray:
        """Return the nodal forces (n_dofs,) of a step, N."""
        result = np.zeros(self.n_dofs)
        for name, load in self.loads.items():
            if factors[name]:
                result += factors[name] * load
        return result

    def fixed_values(self, factors: Mapping[str, float]) -> np.ndarray:
        """Return the prescribed displacement (n_dofs,) of a step, zero at free dofs, m. Supports without
        a factor hold the full values of the problem."""
        result = np.zeros(self.n_dofs)
        for name, (dofs, values) in self.prescribed.items():
            result[dofs] += factors.get(name, 1.0) * values
        self._check_holds(result, factors)
        return result

    def _check_holds(self, prescribed: np.ndarray, factors: Mapping[str, float]) -> None:
        """Raise ValueError if a displacement (n_dofs,), m, is not that of every support, where several
        hold a node along one direction."""
        allowed = checks.ALIKE * np.abs(prescribed).max(initial=0.0)
        for hold in self.holds:
            moved = prescribed.reshape(-1, len(hold.direction))[hold.nodes] @ hold.direction
            expected = factors.get(hold.support.path_name, 1.0) * hold.values
            differs = np.abs(moved - expected) > allowed
            if differs.any():
                node = hold.nodes[np.argmax(differs)]
                names = dict.fromkeys(
                    other.support.path_name
                    for other in self.holds
                    if node in other.nodes
                    and np.abs(other.direction @ hold.direction) > checks.ALIKE
                )
                raise ValueError(
                    f"the factors of {' and '.join(map(repr, names))} prescribe different displacements at "
                    f"node {node}, which all of them hold: give them the same factors"
                )


def load_steps(posed: Posed, discrete: DiscreteProblem) -> LoadSteps:
    """Return the loads and supports of a discretised problem by their names in a load path; a preload,
    whose force is met by a strain still to be found, enters with the load of a shortening strain of 1."""
    problem = posed.problem
    mesh = posed.mesh
    loads = {}
    strains = {}
    strain_loads = {}
    for name in dict.fromkeys(load.path_name for load in problem.loads):
        named = [
            load.shortening(mesh.dim) if isinstance(load, Preload) else load
            for load in problem.loads
            if load.path_name == name
        ]
        forces = load_vector(mesh, named, posed.materials, problem.elements)
        loads[name] = discrete.relative_forces(forces)
        if initial_strains := [load for load in named if isinstance(load, InitialStrain)]:
            strains[name] = StressData.of(mesh, posed.materials, initial_strains).initial_strain
            strain_loads[name] = discrete.relative_forces(
                load_vector(mesh, initial_strains, posed.materials, problem.elements)
            )
    return LoadSteps(
        n_dofs=discrete.n_dofs,
        loads=loads,
        prescribed=posed.prescribed_parts,
        holds=posed.holds if posed.prescribed.any() else (),  # zeros agree with any factors
        stress=StressData.of(mesh, posed.materials, elements=problem.elements),
        strains=strains,
        strain_loads=strain_loads,
        posed=posed,
    )


def whole_load(discrete: DiscreteProblem) -> LoadSteps:
    """Return all loads and prescribed displacements of a problem without names, as one."""
    dofs = np.flatnonzero(discrete.fixed_values)
    return LoadSteps(
        n_dofs=discrete.n_dofs,
        loads={DEFAULT: discrete.load},
        prescribed={DEFAULT: (dofs, discrete.fixed_values[dofs])},
    )
