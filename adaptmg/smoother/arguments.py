"""The one check of arrays before they reach the kernels, which check nothing; it reads shapes and types only."""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptmg.smoother.system import LocalSystem, NodalContact

__all__ = ["check_contact", "check_vector"]


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
