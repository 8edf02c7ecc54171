r"""ProjectedGaussSeidel: block Gauss-Seidel / SOR with the exact contact problem solved at each contact node.

The paper's smoother (a relaxation with projection onto the contact and friction conditions). One step takes the node's
block of unknowns to the minimum of the functional over that block (omega = 1), in the metric :math:`D/\omega` in
general; see :mod:`adaptmg.smoother.node_solve`.

Coulomb's bound :math:`\mu p` follows the iterate inside each node solve (the diagonal process). Over-relaxed sweeps may
then cycle (from omega = 1.65 on).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg.smoother import kernels
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.residuals import check
from adaptmg.smoother.system import LocalSystem, NodalContact

_DIRECTIONS = {"forward": (1,), "backward": (-1,), "symmetric": (1, -1)}


class Smoother(Protocol):
    """What a smoother must offer."""

    def smooth(self, system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
               sweeps: int) -> float:
        """Improve ``unknowns`` in place by ``sweeps`` sweeps; return the passes over the matrix that it took."""


@dataclass(frozen=True, kw_only=True)
class ProjectedGaussSeidel:
    """Projected block Gauss-Seidel (omega = 1) or SOR.

    Parameters
    ----------
    omega : float
        Relaxation factor, 0 < omega < 2. 1 is best inside multigrid; alone on a fine mesh a factor near 2 is.
    order : {"forward", "backward", "symmetric"}
        Order of the nodes in a sweep. A symmetric sweep is one forward and one backward pass.

    Examples
    --------
    >>> smoother = am.ProjectedGaussSeidel(omega=1.2, order="symmetric")
    >>> am.Multigrid(correction=am.Monotone(), smoother=smoother).smoother.omega
    1.2
    """

    omega: float = 1.0
    order: Literal["forward", "backward", "symmetric"] = "forward"

    def __post_init__(self) -> None:
        omega = checks.number("omega", self.omega)
        if not 0 < omega < 2:
            raise ValueError(f"omega must be in (0, 2), got {self.omega!r}")
        object.__setattr__(self, "omega", omega)
        checks.choice("order", self.order, _DIRECTIONS)

    def smooth(self, system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
               sweeps: int = 1) -> float:
        """Sweep in place.

        Parameters
        ----------
        system : LocalSystem
        contact : NodalContact
        load : (n_dofs,) array
            b (dual), local components, zero at fixed dofs, N.
        unknowns : (n_dofs,) array
            w (primal), local components, zero at fixed dofs, m; changed. It is admissible afterwards.
        sweeps : int

        Returns
        -------
        float
            Passes over the matrix: 1 a sweep (symmetric: 2).
        """
        check(system, checks.instance("contact", contact, NodalContact), load=load, unknowns=unknowns)
        if not unknowns.flags.writeable:
            raise ValueError("unknowns is read-only but is changed in place: pass unknowns.copy()")
        steps = _DIRECTIONS[self.order] * checks.integer("sweeps", sweeps)
        for step in steps:
            kernels.sweep(ZERO[system.dim], 0 if step > 0 else system.n_nodes - 1, step, system.indptr, system.indices,
                          system.data, system.diagonal, system.inverse, system.contact_of, contact.gap,
                          contact.slip_reference.reshape(-1), contact.limit, contact.friction, load, unknowns,
                          self.omega)
        return float(len(steps))
