"""ContactNodes: the nodes that may touch an obstacle or another body, with normals, gaps and weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["ContactNodes", "frozen_array"]


def frozen_array(name: str, value: object, shape: tuple[int | None, ...], dtype: type = np.float64) -> np.ndarray:
    """A read-only copy of the wanted shape (None: any) and type, finite; of read-only arrays themselves."""
    if type(value) is np.ndarray and value.dtype == dtype and value.base is None and not value.flags.writeable:
        result = np.ascontiguousarray(value)
    else:
        result = np.array(value, dtype=dtype, order="C")
    if len(result.shape) != len(shape) or any(w is not None and w != g
                                              for w, g in zip(shape, result.shape, strict=True)):
        wanted = "(" + ", ".join("n" if w is None else str(w) for w in shape) + ")"
        raise ValueError(f"{name} must have shape {wanted}, got {result.shape}")
    if dtype is np.float64 and not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite; {np.count_nonzero(~np.isfinite(result))} entries are not")
    result.flags.writeable = False
    return result


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
        nodes = np.asarray(self.nodes)
        if nodes.dtype.kind not in "iu":
            raise TypeError(f"nodes must be integers, got {nodes.dtype}")
        nodes = frozen_array("nodes", nodes, (None,), np.int64)
        n = len(nodes)
        if n == 0:
            raise ValueError("nodes is empty: a contact problem needs at least one contact node")
        if len(np.unique(nodes)) < n or nodes.min() < 0:
            raise ValueError("nodes must be distinct and >= 0")
        normals = frozen_array("normals", self.normals, (n, None))
        if normals.shape[1] not in (2, 3):
            raise ValueError(f"normals must have shape ({n}, 2) or ({n}, 3), got {normals.shape}")
        lengths = np.linalg.norm(normals, axis=1)
        if np.abs(lengths - 1).max() > 1e-6:
            i = int(np.argmax(np.abs(lengths - 1)))
            raise ValueError(f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}")
        normals = normals / lengths[:, None]
        normals.flags.writeable = False
        gaps = frozen_array("gaps", self.gaps, (n,))
        if not self.allow_interference and gaps.min() < 0:
            i = int(np.argmin(gaps))
            raise ValueError(f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                             "for an interference fit say allow_interference=True")
        weights = frozen_array("weights", np.ones(n) if self.weights is None else self.weights, (n,))
        if not weights.min() > 0:
            raise ValueError(f"weights must be > 0, got {weights.min():.6g}")
        reference = np.zeros_like(normals) if self.slip_reference is None else self.slip_reference
        reference = frozen_array("slip_reference", reference, normals.shape)
        boundary = np.zeros(n, dtype=np.int64) if self.boundary is None else self.boundary
        boundary = frozen_array("boundary", boundary, (n,), np.int64)
        if boundary.min() < 0 or boundary.max() >= len(self.names):
            raise ValueError(f"boundary must index names ({len(self.names)} given), got {boundary.max()}")
        names = tuple(self.names)
        masters = ("",) * len(names) if self.masters is None else tuple(self.masters)
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        for name, value in (("nodes", nodes), ("normals", normals), ("gaps", gaps), ("weights", weights),
                            ("slip_reference", reference), ("boundary", boundary), ("names", names),
                            ("masters", masters)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.normals.shape[1]
