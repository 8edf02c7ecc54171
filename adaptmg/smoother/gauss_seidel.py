r"""ProjectedGaussSeidel: block Gauss-Seidel / SOR with the exact contact problem solved at each
contact node.

The paper's smoother (a relaxation with projection onto the contact and friction conditions). A
sweep visits the nodes in order; with the residual :math:`r_i = b_i - \sum_j A_{ij} w_j` and D the
diagonal block

.. math:: w_i \leftarrow w_i + \omega D^{-1} r_i

away from contact, and at a contact node w_i becomes the solution of
:mod:`adaptmg.smoother.node_solve` with
:math:`M = D/\omega`, :math:`c = r_i + M w_i`: the minimum of the functional over that block (omega = 1), in the metric
M in general. For Tresca's law and :math:`0 < \omega < 2` no step can raise the energy. Coulomb's
bound :math:`\mu p` follows the iterate inside each node solve (the diagonal process). Over-relaxed
sweeps may then cycle (from omega = 1.65 on)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.smoother.blocks import (
    ORIGIN,
    ZERO,
    add,
    minus_row,
    over,
    plus_symmetric,
    read,
    scale,
    times,
    upper,
    write,
)
from adaptmg.smoother.node_solve import read_reference, solve
from adaptmg.smoother.system import LocalSystem, NodalContact

#: relaxation factor of sweeps
Omega = Annotated[float, checks.number_that("in (0, 2)", lambda x: 0 < x < 2)]
_DIRECTIONS = {"forward": (1,), "backward": (-1,), "symmetric": (1, -1)}


class Smoother(Protocol):
    """The protocol of a smoother."""

    def smooth(
        self,
        system: LocalSystem,
        contact: NodalContact,
        load: np.ndarray,
        unknowns: np.ndarray,
        sweeps: int,
    ) -> float:
        """Improve ``unknowns`` in place by ``sweeps`` sweeps; return the passes over the matrix
        that it took. Arguments are those of :meth:`ProjectedGaussSeidel.smooth`."""
        ...


@dataclass(frozen=True, kw_only=True)
class ProjectedGaussSeidel(checks.Checked):
    """Projected block Gauss-Seidel (omega = 1) or SOR.

    Parameters
    ----------
    omega : float
        Relaxation factor, 0 < omega < 2. 1 is best inside multigrid; alone on a fine mesh a factor
        near 2 is.
    order : {"forward", "backward", "symmetric"}
        Order of the nodes in a sweep. A symmetric sweep is one forward and one backward pass.

    Examples
    --------
    >>> smoother = am.ProjectedGaussSeidel(omega=1.2, order="symmetric")
    >>> am.Multigrid(correction=am.Monotone(), smoother=smoother).smoother.omega
    1.2
    """

    omega: Omega = 1.0
    order: Literal["forward", "backward", "symmetric"] = "forward"

    def smooth(
        self,
        system: LocalSystem,
        contact: NodalContact,
        load: np.ndarray,
        unknowns: np.ndarray,
        sweeps: int = 1,
    ) -> float:
        """Sweep in place.

        Parameters
        ----------
        system : LocalSystem
        contact : NodalContact
        load : (n_dofs,) array
            b (dual), local components, zero at fixed dofs, N.
        unknowns : (n_dofs,) array
            w (primal), local components, zero at fixed dofs, m; changed. It is admissible
            afterwards.
        sweeps : int

        Returns
        -------
        float
            Passes over the matrix: 1 a sweep (symmetric: 2).
        """
        _check(
            system, checks.instance("contact", contact, NodalContact), load=load, unknowns=unknowns
        )
        if not unknowns.flags.writeable:
            raise ValueError("unknowns is read-only but is changed in place: pass unknowns.copy()")
        steps = _DIRECTIONS[self.order] * checks.integer("sweeps", sweeps)
        for step in steps:
            _sweep(
                ZERO[system.dim],
                0 if step > 0 else system.n_nodes - 1,
                step,
                system.indptr,
                system.indices,
                system.data,
                system.diagonal,
                system.inverse,
                system.contact_of,
                contact.gap,
                contact.reference,
                contact.limit,
                contact.friction,
                contact.compliances,
                load,
                unknowns,
                self.omega,
            )
        return float(len(steps))


def _check(system: LocalSystem, contact: NodalContact, **vectors: np.ndarray) -> None:
    """Raise unless ``vectors`` (n_dofs,) and the arrays of ``contact`` are as the kernel, which
    checks nothing, reads them: contiguous float64 arrays that fit ``system``."""
    expected: dict[str, tuple[np.ndarray, tuple[int, ...]]]
    expected = {name: (value, (system.n_dofs,)) for name, value in vectors.items()}
    n = len(system.nodes)
    shapes = {"gap": (n,), "limit": (n,), "friction": (n,), "slip_reference": (n, system.dim - 1)}
    if contact.compliance is not None:
        shapes["compliance"] = (n,)
    # of scalar problems the kernel reads ``lowest`` in place of the slip_reference
    if system.dim == 1:
        shapes["lowest"] = (n,)
    elif contact.lowest is not None:
        raise ValueError(f"contact.lowest must be None with {system.dim} unknowns a node")
    expected |= {
        f"contact.{name}": (getattr(contact, name), shape) for name, shape in shapes.items()
    }
    for name, (value, shape) in expected.items():
        if not isinstance(value, np.ndarray) or value.dtype != np.float64:
            kind = (
                f"an array of {value.dtype}"
                if isinstance(value, np.ndarray)
                else type(value).__name__
            )
            raise TypeError(f"{name} must be a numpy array of float64, got {kind}")
        if value.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, got {value.shape}")
        if not value.flags.c_contiguous:
            raise ValueError(f"{name} must be contiguous: pass numpy.ascontiguousarray({name})")


@inner_kernel(forceinline=True)
def _contact_solve(i, contact, diagonal, gap, reference, limit, friction, compliance, w, omega, r):
    """Return the new unknowns of node i, number ``contact`` of the contact nodes, from its residual
    ``r``: the solution of the node problem with M = D / omega and c = r + M w."""
    dim = np.uint64(len(r))
    m = over(upper(diagonal, dim * dim * i, r), omega)
    return solve(
        m,
        plus_symmetric(r, m, read(w, dim * i, r)),
        gap[contact],
        read_reference(reference, contact, r),
        limit[contact],
        friction[contact],
        compliance[contact],
    )


@kernel
def _sweep(
    zero,
    first,
    step,
    indptr,
    indices,
    data,
    diagonal,
    inverse,
    contact_of,
    gap,
    reference,
    limit,
    friction,
    compliance,
    load,
    w,
    omega,
):
    """Sweep over all nodes, changing ``w`` (n_dofs,): ``first, step`` are 0, 1 (forward) or
    n_nodes - 1, -1 (backward). ``contact_of`` has the number of a contact node, -1 elsewhere. Other
    arrays are those of :class:`LocalSystem` and, from ``gap`` on, of :class:`NodalContact`."""
    dim = np.uint64(len(zero))
    for visit in range(len(contact_of)):
        i = np.uint64(first + visit * step)
        at = dim * i  # its first dof; its blocks begin at dim * at
        r = minus_row(i, ORIGIN, step, indptr, indices, data, w, read(load, at, zero))
        if contact_of[i] < 0:
            write(w, at, add(read(w, at, zero), scale(omega, times(inverse, dim * at, r))))
        else:
            write(
                w,
                at,
                _contact_solve(
                    i,
                    np.uint64(contact_of[i]),
                    diagonal,
                    gap,
                    reference,
                    limit,
                    friction,
                    compliance,
                    w,
                    omega,
                    r,
                ),
            )
