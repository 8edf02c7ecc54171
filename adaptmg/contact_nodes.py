"""ContactNodes: the nodes that may touch an obstacle or another body, with normals, gaps and weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discrete_input import SMALLEST, bounded
from adaptmg.problem import check_arrays, checks
from adaptmg.problem.contact_problem import CONTACT

__all__ = ["ContactNodes"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactNodes:
    """Nodes that may touch an obstacle.

    Parameters
    ----------
    nodes : (n_contact,) array of int
        Node numbers, each once.
    normals : (n_contact, dim) array
        Unit normals, out of the body.
    gaps : (n_contact,) array
        Initial gap g0 along the normal, m; >= 0 unless ``allow_interference``.
    weights : (n_contact,) array, optional
        Lumped boundary mass (m in 2D, m^2 in 3D), to turn nodal forces into tractions. Default 1.
    slip_reference : (n_contact, dim) array, optional
        Displacement against which slip is measured, m (only its tangential part counts). Default 0.
    allow_interference : bool
        Accept negative gaps.
    boundary : (n_contact,) array of int, optional
        Index of the contact boundary of each node, for resultants; default 0.
    names : tuple of str
        Names of the contact boundaries.
    masters : tuple of str, optional
        For each of ``names`` the boundary of another body that it may touch; "" (the default) is a rigid obstacle.
    """

    nodes: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    weights: np.ndarray | None = None
    slip_reference: np.ndarray | None = None
    allow_interference: bool = False
    boundary: np.ndarray | None = None
    names: tuple[str, ...] = ("contact",)
    masters: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        nodes = check_arrays.array("nodes", self.nodes, (None,), integer=True)
        n = len(nodes)
        if n == 0:
            raise ValueError("nodes is empty: a contact problem needs at least one contact node")
        if len(np.unique(nodes)) < n or nodes.min() < 0:
            raise ValueError("nodes must be distinct and >= 0")
        checks.flag("allow_interference", self.allow_interference)
        normals = bounded("normals", self.normals, (n, None), 2.0)
        if normals.shape[1] not in (2, 3):
            raise ValueError(f"normals must have shape ({n}, 2) or ({n}, 3), got {normals.shape}")
        lengths = np.linalg.norm(normals, axis=1)
        if np.abs(lengths - 1).max() > 1e-6:
            i = int(np.argmax(np.abs(lengths - 1)))
            raise ValueError(f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}")
        normals = normals / lengths[:, None]
        normals.flags.writeable = False
        gaps = bounded("gaps", self.gaps, (n,), checks.VAST)
        if not self.allow_interference and gaps.min() < 0:
            i = int(np.argmin(gaps))
            raise ValueError(f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                             "for an interference fit say allow_interference=True")
        weights = bounded("weights", np.ones(n) if self.weights is None else self.weights, (n,))
        if not weights.min() > 0 or weights.min() < SMALLEST:
            raise ValueError(f"weights must be > 0, and at least {SMALLEST:g}, got {weights.min():.6g}")
        reference = np.zeros_like(normals) if self.slip_reference is None else self.slip_reference
        reference = bounded("slip_reference", reference, normals.shape, checks.VAST)
        names, masters = self._names()
        boundary = np.zeros(n, dtype=np.int64) if self.boundary is None else self.boundary
        boundary = check_arrays.array("boundary", boundary, (n,), integer=True)
        if boundary.min() < 0 or boundary.max() >= len(names):
            wrong = boundary.min() if boundary.min() < 0 else boundary.max()
            raise ValueError(f"boundary must index names ({len(names)} given), got {wrong}")
        for name, value in (("nodes", nodes), ("normals", normals), ("gaps", gaps), ("weights", weights),
                            ("slip_reference", reference), ("boundary", boundary), ("names", names),
                            ("masters", masters)):
            object.__setattr__(self, name, value)

    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the contact boundaries and of what they may touch, checked."""
        names = checks.strings("names", self.names)
        if not names:
            raise ValueError("names is empty: give one name at least")
        masters = ("",) * len(names)
        if self.masters is not None:
            masters = tuple("" if isinstance(item, str) and not item else checks.boundary_name(f"masters[{i}]", item)
                            for i, item in enumerate(checks.listed("masters", self.masters, "names")))
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        return names, masters

    def check_name_contact(self) -> None:
        """``Result.resultant("contact")`` is that of all contact boundaries: no other may have this name."""
        if CONTACT in self.masters or (CONTACT in self.names and len(self.names) > 1):
            raise ValueError(f"contact: the name {CONTACT!r} stands for all contact boundaries together; of several "
                             f"names and masters none may be it, got {self.names} and {self.masters}")

    def check_nodes(self, n_nodes: int) -> None:
        """ValueError unless there are so many nodes that each of these is one."""
        if self.nodes.max() >= n_nodes:
            raise ValueError(f"contact.nodes: node {self.nodes.max()} does not exist; there are {n_nodes} nodes")

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.normals.shape[1]
