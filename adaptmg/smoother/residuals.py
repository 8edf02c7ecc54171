r"""Residuals, forces, states and energy of an iterate in local components.

With r = b - A w, the force on the body at a contact node is -r, and p = max(0, r_n) its compressive magnitude. The
natural residual

.. math:: D\,(\mathrm{prox}_D(w - D^{-1}(A w - b)) - w)

with D the block diagonal of A and :math:`\mathrm{prox}_D` the exact node solve of
:mod:`adaptmg.smoother.node_solve` in the metric D, its bound held at :math:`s + \mu\,p(w)`, is a force. It vanishes
exactly at the solution, Coulomb's law included; away from contact it is r.

Each function is one pass over the matrix, but for :func:`normal_force` and :func:`contact_state`: these read only the
rows of the contact nodes, the share :func:`contact_share` of a pass.

The one check of arrays before they reach the kernels, which check nothing; it reads shapes and types only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptmg.smoother import kernels
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.compiling import notice
from adaptmg.smoother.system import LocalSystem, NodalContact, contact_codes, contact_states

__all__ = ["check_contact", "check_vector", "contact_share", "contact_state", "energy", "natural_at_nodes",
           "natural_residual", "normal_force", "residual", "states"]

def residual(system: LocalSystem, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """The residual b - A w (dual), contact forces kept.

    Parameters
    ----------
    system : LocalSystem
    load : (n_dofs,) array
        b, local components, zero at fixed dofs, N.
    unknowns : (n_dofs,) array
        w, local components, m.

    Returns
    -------
    (n_dofs,) array
        N. At a contact node minus the force of the obstacle on the body.
    """
    check_vector("load", load, system)
    check_vector("unknowns", unknowns, system)
    notice(kernels.residual)
    result = np.empty(system.n_dofs)
    kernels.residual(ZERO[system.dim], system.indptr, system.indices, system.data, load, unknowns, result)
    return result


def natural_residual(system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
                     defect: np.ndarray | None = None) -> np.ndarray:
    """The natural residual (dual), a vector whose norm says how far the conditions of the problem are from being met.

    Parameters
    ----------
    system : LocalSystem
    contact : NodalContact
    load, unknowns : (n_dofs,) arrays
        N and m; local components.
    defect : (n_dofs,) array, optional
        b - A w where it is known already: then no pass over the matrix is needed.

    Returns
    -------
    (n_dofs,) array
        N; zero exactly at the solution, up to rounding.
    """
    check_contact(system, contact)
    if defect is None:
        result = residual(system, load, unknowns)
    else:
        check_vector("unknowns", unknowns, system)
        check_vector("defect", defect, system)
        result = defect.copy()
    notice(kernels.natural_residual)
    kernels.natural_residual(ZERO[system.dim], system.nodes, system.diagonal, contact.gap,
                             contact.slip_reference.reshape(-1), contact.limit, contact.friction, unknowns, result)
    return result


def normal_force(system: LocalSystem, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Compressive nodal force p = max(0, (b - A w)_n) at the contact nodes.

    Returns
    -------
    (n_contact,) array
        N, >= 0.
    """
    check_vector("load", load, system)
    check_vector("unknowns", unknowns, system)
    notice(kernels.normal_residual)
    result = np.empty(len(system.nodes))
    kernels.normal_residual(ZERO[system.dim], system.nodes, system.indptr, system.indices, system.data, load,
                            unknowns, result)
    return np.maximum(result, 0.0, out=result)


def contact_share(system: LocalSystem) -> float:
    """The part of the matrix that the rows of the contact nodes hold: what :func:`normal_force` costs, in passes."""
    blocks = system.indptr[system.nodes + 1] - system.indptr[system.nodes]
    return float(blocks.sum()) * system.dim**2 / system.nonzeros


def contact_state(system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
                  *, tolerance: float = 1e-12) -> np.ndarray:
    """State of each contact node, as codes of :class:`~adaptmg.smoother.system.ContactState`.

    OPEN where there is a gap, or no compressive force; otherwise STICK where the slip is zero and the bound
    s + mu p is positive, and SLIP elsewhere (so a frictionless node that touches always slips). The smoother puts
    gaps and slips that vanish exactly on zero; the tolerance lets through the rounding of what other methods leave.

    Parameters
    ----------
    system : LocalSystem
    contact : NodalContact
    load, unknowns : (n_dofs,) arrays
        N and m; local components.
    tolerance : float
        A gap or slip counts as zero up to this times the largest ``|unknowns|``.

    Returns
    -------
    (n_contact,) int8 array
    """
    check_contact(system, contact)
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance must be >= 0 and < 1, got {tolerance!r}")
    return states(contact, unknowns.reshape(-1, system.dim)[system.nodes], normal_force(system, load, unknowns),
                  tolerance * np.abs(unknowns).max(initial=0.0))


def states(contact: NodalContact, values: np.ndarray, normal_force: np.ndarray, small: float) -> np.ndarray:
    """:func:`contact_state` from the unknowns (n_contact, dim) and p (n_contact,); ``small`` (m) counts as zero."""
    slip = np.linalg.norm(values[:, 1:] - contact.slip_reference, axis=1)
    held = (slip <= small) & (contact.limit + contact.friction * normal_force > 0)
    return contact_states(contact_codes(~(contact.gap - values[:, 0] > small), held), normal_force)


def natural_at_nodes(contact: NodalContact, blocks: np.ndarray, values: np.ndarray, defect: np.ndarray) -> np.ndarray:
    """The natural residual at contact nodes alone (n_contact, dim)."""
    result, dim = np.array(defect).reshape(-1), values.shape[1]
    notice(kernels.natural_residual)
    nodes = np.arange(len(values), dtype=np.int32)
    kernels.natural_residual(ZERO[dim], nodes, np.ascontiguousarray(blocks).reshape(-1), contact.gap,
                             contact.slip_reference.reshape(-1), contact.limit, contact.friction,
                             np.ascontiguousarray(values).reshape(-1), result)
    return result.reshape(-1, dim)


def energy(system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> float:
    """The functional 1/2 w'Aw - b'w + sum of limit * |w_t - slip_reference| that Tresca's problem minimises.

    ``contact.friction`` does not enter (Coulomb's law has no energy): pass ``contact.frozen(p)`` for the energy of the
    Tresca problem at the normal force p. The gaps are not looked at.

    Returns
    -------
    float
        N m.
    """
    check_contact(system, contact)
    check_vector("load", load, system)
    check_vector("unknowns", unknowns, system)
    notice(kernels.energy)
    return float(kernels.energy(ZERO[system.dim], system.indptr, system.indices, system.data, system.nodes,
                                contact.slip_reference.reshape(-1), contact.limit, load, unknowns))


def check_vector(name: str, value: Any, system: LocalSystem, *, changed: bool = False) -> None:
    """Raise unless ``value`` is a contiguous float64 (n_dofs,) array; ``changed``: it must be writeable too."""
    _check_array(name, value, (system.n_dofs,), f"one number a dof of the system with {system.n_nodes} nodes")
    if changed and not value.flags.writeable:
        raise ValueError(f"{name} is read-only but is changed in place: pass {name}.copy()")


def check_contact(system: LocalSystem, contact: Any) -> None:
    """Raise unless ``contact`` is a NodalContact whose arrays fit the contact nodes of ``system``."""
    if not isinstance(contact, NodalContact):
        raise TypeError(f"contact must be a NodalContact, got {type(contact).__name__}")
    n = len(system.nodes)
    meaning = f"there are {n} contact nodes"
    for name in ("gap", "limit", "friction"):
        _check_array(f"contact.{name}", getattr(contact, name), (n,), meaning)
    _check_array("contact.slip_reference", contact.slip_reference, (n, system.dim - 1), meaning)


def _check_array(name: str, value: Any, shape: tuple[int, ...], meaning: str) -> None:
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        given = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"{name} must be a numpy array of float64, got {given}")
    if value.shape != shape:
        raise ValueError(f"{name} must have shape {shape} ({meaning}), got {value.shape}")
    if not value.flags.c_contiguous:
        raise ValueError(f"{name} must be contiguous: pass numpy.ascontiguousarray({name})")
