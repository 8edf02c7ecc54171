r"""Residuals and contact states of an iterate in local components.

With r = b - A w, the force on the body at a contact node is -r, and p = max(0, r_n) its compressive magnitude. The
natural residual

.. math:: D\,(\mathrm{prox}_D(w - D^{-1}(A w - b)) - w)

with D the block diagonal of A and :math:`\mathrm{prox}_D` the exact node solve of
:mod:`adaptmg.smoother.node_solve` in the metric D, its bound held at :math:`s + \mu\,p(w)`, is a force. It vanishes
exactly at the solution, Coulomb's law included; away from contact it is r.
"""

from __future__ import annotations

import numpy as np

from adaptmg.smoother import kernels
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.system import LocalSystem, NodalContact, contact_codes, contact_states


def residual(system: LocalSystem, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Return the residual b - A w (n_dofs,), N, contact forces included, from b and w (n_dofs,), local components."""
    check(system, load=load, unknowns=unknowns)
    result = np.empty(system.n_dofs)
    kernels.residual(ZERO[system.dim], system.indptr, system.indices, system.data, load, unknowns, result)
    return result


def natural_residual(system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
                     linear: np.ndarray | None = None) -> np.ndarray:
    """Return the natural residual (n_dofs,), N: zero exactly at the solution, up to rounding.

    ``linear`` (n_dofs,) is b - A w where it is known already; no pass over the matrix is needed then.
    """
    check(system, contact, unknowns=unknowns, linear=unknowns if linear is None else linear)
    result = residual(system, load, unknowns) if linear is None else linear.copy()
    kernels.natural_residual(ZERO[system.dim], system.nodes, system.diagonal, contact.gap,
                             contact.slip_reference.reshape(-1), contact.limit, contact.friction, unknowns, result)
    return result


def natural_at_nodes(contact: NodalContact, blocks: np.ndarray, values: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """Return the natural residual (n_contact, dim), from diagonal blocks of contact nodes, unknowns and b - A w."""
    result, dim = np.array(linear).reshape(-1), values.shape[1]
    nodes = np.arange(len(values), dtype=np.int32)
    kernels.natural_residual(ZERO[dim], nodes, np.ascontiguousarray(blocks).reshape(-1), contact.gap,
                             contact.slip_reference.reshape(-1), contact.limit, contact.friction,
                             np.ascontiguousarray(values).reshape(-1), result)
    return result.reshape(-1, dim)


def states(contact: NodalContact, values: np.ndarray, normal_force: np.ndarray, small: float) -> np.ndarray:
    """Return the :class:`~adaptmg.smoother.system.ContactState` (n_contact,) int8 of unknowns (n_contact, dim) and p.
    OPEN where there is a gap, or no compressive force; otherwise STICK where the slip is zero and the bound s + mu p is
    positive, and SLIP elsewhere. A gap or slip up to ``small`` (m) counts as zero."""
    slip = np.linalg.norm(values[:, 1:] - contact.slip_reference, axis=1)
    held = (slip <= small) & (contact.limit + contact.friction * normal_force > 0)
    return contact_states(contact_codes(~(contact.gap - values[:, 0] > small), held), normal_force)


def check(system: LocalSystem, contact: NodalContact | None = None, **vectors: np.ndarray) -> None:
    """Raise unless ``vectors`` (n_dofs,) and the arrays of ``contact`` are as the kernels, which check nothing, read
    them: contiguous float64 arrays that fit ``system``."""
    expected = {name: (value, (system.n_dofs,)) for name, value in vectors.items()}
    if contact is not None:
        n = len(system.nodes)
        expected |= {f"contact.{name}": (getattr(contact, name), (n,)) for name in ("gap", "limit", "friction")}
        expected["contact.slip_reference"] = contact.slip_reference, (n, system.dim - 1)
    for name, (value, shape) in expected.items():
        if not isinstance(value, np.ndarray) or value.dtype != np.float64:
            kind = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
            raise TypeError(f"{name} must be a numpy array of float64, got {kind}")
        if value.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, got {value.shape}")
        if not value.flags.c_contiguous:
            raise ValueError(f"{name} must be contiguous: pass numpy.ascontiguousarray({name})")
