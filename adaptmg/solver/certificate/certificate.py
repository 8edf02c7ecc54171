r"""Certificate: whether a displacement solves the contact problem, recomputed from the raw matrices.

Nothing here comes from the solvers, their frames or their kernels: products with the stored matrix, unit normals n and
projections I - n n' in Cartesian components. With :math:`r = A u - b`, the claimed contact forces
:math:`f = -p\,n + f_t`, their bound :math:`s + \mu p` and the slip :math:`\tau` it measures

.. math:: r - f = 0, \quad u_n \le g_0, \quad p \ge 0, \quad p\,(g_0 - u_n) = 0, \quad
          |f_t| \le s + \mu p, \quad (s + \mu p)\,|\tau| + f_t \cdot \tau = 0,

prescribed values, the claimed states, the balance of all forces, and the energy error
(:mod:`adaptmg.solver.certificate.energy`). Forces are relative to loads and reactions, lengths to the largest
displacement, energies to u'Au: never to a lifted nodal jump.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.runtime.threads import one_blas_thread
from adaptmg.solver.certificate.aggregates import Aggregates
from adaptmg.solver.certificate.lines import Condition, ContactClaims, Evidence

__all__ = ["Certificate", "Condition", "certify"]


@dataclass(frozen=True, repr=False)
class Certificate:
    """By how much each condition of the contact problem is violated. Printing it shows a table.

    Attributes
    ----------
    lines : tuple of Condition
        'equilibrium' (of free dofs, under the claimed contact forces), 'prescribed values', 'penetration', 'tension',
        'complementarity' (the smaller of pressure and gap, each in its own scale), 'friction bound', 'slip direction'
        (the work of friction on its bound and opposite to the slip, less that of the claimed friction),
        'slip along the force' (weighted by force, over the actual ones), 'open, touching' (forces at nodes said to be
        open), 'touching, open' (gaps at nodes said to touch), 'slip, sticking' (slip at nodes said to stick), 'balance'
        (sum of loads and all reactions).
    energy_error : float
        Estimated ||u - u_h||_A / ||u||_A with the contact status held, by a few preconditioned steps: rather too small
        than too large. With ``bound=True`` by a factorisation: exact for this status.
    energy_rounding : float
        As much of it as rounding explains.
    exact_energy : bool
        Whether it was made by a factorisation.
    force, displacement, energy_norm : float
        What the lines are relative to: N, m, and sqrt(u'Au) (sqrt(N m)); in 2D per metre of thickness.
    """

    lines: tuple[Condition, ...]
    energy_error: float
    energy_rounding: float
    exact_energy: bool
    force: float
    displacement: float
    energy_norm: float

    #: lines beyond this multiple of rtol contradict a solver that says it has converged (as for its residual)
    FACTOR = 20.0
    #: and an energy error beyond this
    ENERGY_FACTOR = 3.0
    #: relative violations that rounding may excuse at most; no solver of this package reaches less than about 1e-12
    MOST_ROUNDING = 1e-9

    def __getitem__(self, name: str) -> Condition:
        for line in self.lines:
            if line.name == name:
                return line
        raise KeyError(f"no line {name!r}; there are {', '.join(line.name for line in self.lines)}")

    @property
    def worst(self) -> Condition:
        """The line with the largest relative violation."""
        return max(self.lines, key=lambda line: np.inf if np.isnan(line.relative) else line.relative)

    def contradictions(self, rtol: float, energy_factor: float = ENERGY_FACTOR) -> tuple[str, ...]:
        """Names of what a displacement that has converged to ``rtol`` would not violate so much."""
        def beyond(value: float, allowed: float, rounding: float) -> bool:
            return not value <= max(allowed, min(rounding, self.MOST_ROUNDING))
        found = [line.name for line in self.lines if beyond(line.relative, self.FACTOR * rtol, line.rounding)]
        if beyond(self.energy_error, energy_factor * rtol, self.energy_rounding):
            found.append("energy error")
        return tuple(found)

    def as_dict(self) -> dict[str, Any]:
        """Numbers and strings alone, for files."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Certificate:
        """The inverse of :meth:`as_dict`."""
        return cls(**(values | {"lines": tuple(Condition(**line) for line in values["lines"])}))

    def __repr__(self) -> str:
        rows = [f"Certificate: forces relative to {self.force:.3g} N, lengths to {self.displacement:.3g} m, energy to "
                f"{self.energy_norm**2:.3g} N m", f"{'':<22} {'largest':>9} {'in all':>9} {'':<4} {'relative':>9}"]
        rows += [f"{line.name:<22} {line.largest:>9.2e} {line.total:>9.2e} {line.unit:<4} {line.relative:>9.2e}"
                 for line in self.lines]
        how = "exact for this contact status" if self.exact_energy else "estimated, contact status held"
        return "\n".join([*rows, f"{'energy error':<22} {'':>9} {'':>9} {'':<4} {self.energy_error:>9.2e}  ({how})"])


@one_blas_thread()
def certify(problem: DiscreteProblem, displacement: np.ndarray, contact: ContactClaims, bound: bool = False,
            images: np.ndarray | None = None, aggregates: Aggregates | None = None) -> Certificate:
    """Check a displacement and the contact forces and states that go with it.

    Parameters
    ----------
    problem : DiscreteProblem
    displacement : (n_nodes, dim) array
        Of the bodies (not relative), m.
    contact : ContactResult
        Its forces and states are what is claimed; gaps and slips are computed anew.
    bound : bool
        The energy error by a sparse factorisation, exact for this contact status; else estimated in a few passes over
        the matrix.
    images : (n_dofs,) array, optional
        The stored matrix times the displacement (relative), N, where the caller has made that product already.
    aggregates : Aggregates, optional
        Of the problem, where the caller keeps them.
    """
    if aggregates is None and not bound:
        aggregates = Aggregates(problem)
    # what has run away overflows: its lines read inf or nan, and contradict
    with np.errstate(over="ignore", invalid="ignore"):
        found = Evidence(problem, np.asarray(displacement, dtype=np.float64), contact, images)
        energy, energy_rounding = found.energy_error(None if bound else aggregates)
        lines = (found.equilibrium(), found.prescribed(), *found.normal(), *found.tangential(), *found.states(),
                 found.balance())
    if found.idle:
        # nothing is relative to forces that are rounding: what they leave is told in N alone
        lines = tuple(replace(line, relative=0.0)
                      if not line.unit or (line.unit != "m" and line.largest <= found.rounding) else line
                      for line in lines)
        energy = 0.0
    return Certificate(lines, energy, energy_rounding, bound, found.force, found.length, found.energy)
