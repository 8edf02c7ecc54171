r"""Load steps: nodal loads and prescribed displacements by name, so that every step is a combination of them.

.. math:: b_k = \sum_j \lambda_{kj}\, b_j, \qquad u_{\mathrm{fixed},k} = \lambda_{kj}\, u_{\mathrm{fixed},j}
   \text{ on support } j .
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from adaptmg.discrete.facets import fixed_dofs
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.load_path import DEFAULT, name_in_path
from adaptmg.problem.loads import InitialStrain


@dataclass(frozen=True, eq=False)
class LoadSteps:
    """Loads and prescribed displacements of one mesh, by the names that a load path knows."""

    n_dofs: int
    loads: Mapping[str, np.ndarray]  # dict of str to (n_dofs,)
    prescribed: Mapping[str, tuple[np.ndarray, np.ndarray]]  # dict of str to ((n,) int, (n,))
    stress: StressData | None = None  # what stresses follow from before initial strains; None without a problem
    strains: Mapping[str, np.ndarray] = field(default_factory=dict)  # dict of str to (n_elements, 3)

    def stress_data(self, factors: Mapping[str, float]) -> StressData | None:
        """What the stresses of a step follow from."""
        if not self.strains:
            return self.stress
        return replace(self.stress, initial_strain=sum(factors[name] * strain for name, strain in self.strains.items()))

    def load(self, factors: Mapping[str, float]) -> np.ndarray:
        """Nodal forces (n_dofs,) of a step, N."""
        result = np.zeros(self.n_dofs)
        for name, load in self.loads.items():
            if factors[name]:
                result += factors[name] * load
        return result

    def fixed_values(self, factors: Mapping[str, float]) -> np.ndarray:
        """Prescribed displacement (n_dofs,) of a step, zero at free dofs, m."""
        result = np.zeros(self.n_dofs)
        owner = np.full(self.n_dofs, -1)
        for k, (name, (dofs, values)) in enumerate(self.prescribed.items()):
            scaled = factors.get(name, 1.0) * values
            clash = (owner[dofs] >= 0) & ~np.isclose(result[dofs], scaled, rtol=1e-12, atol=0.0)
            if clash.any():
                dof = int(dofs[np.argmax(clash)])
                other = list(self.prescribed)[owner[dof]]
                raise ValueError(f"the factors of {other!r} and {name!r} prescribe different displacements, "
                                 f"{result[dof]:g} and {scaled[np.argmax(clash)]:g} m, at dof {dof}, which both fix: "
                                 "give both the same factors")
            result[dofs], owner[dofs] = scaled, k
        return result


def load_steps(problem: ContactProblem, mesh: MeshArrays, discrete: DiscreteProblem) -> LoadSteps:
    """The loads and supports of a problem one by one."""
    loads, strains = {}, {}
    for name in dict.fromkeys(map(name_in_path, problem.loads)):
        named = [load for load in problem.loads if name_in_path(load) == name]
        forces = load_vector(mesh, named, problem.material)
        loads[name] = discrete.relative_forces(forces)
        if any(isinstance(load, InitialStrain) for load in named):
            strains[name] = StressData.of(mesh, problem.material, named).initial_strain
    prescribed = {}
    for name in dict.fromkeys(map(name_in_path, problem.supports)):
        fixed, values = fixed_dofs(mesh, [support for support in problem.supports if name_in_path(support) == name])
        dofs = np.flatnonzero(fixed)
        prescribed[name] = dofs, values[dofs]
    return LoadSteps(mesh.n_nodes * mesh.dim, loads, prescribed, StressData.of(mesh, problem.material), strains)


def whole_load(discrete: DiscreteProblem) -> LoadSteps:
    """All loads and prescribed displacements of a problem without names, as one."""
    dofs = np.flatnonzero(discrete.fixed)
    return LoadSteps(discrete.n_dofs, {DEFAULT: discrete.load}, {DEFAULT: (dofs, discrete.fixed_values[dofs])})
