"""Level: one grid of a hierarchy, with the problem on it and the prolongation from the next coarser one."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import check_arrays, checks
from adaptmg.problem.index_arrays import indices_frozen
from adaptmg.runtime.on_demand import OnDemand, made_on_demand

__all__ = ["Level", "ratio_to"]


@dataclass(frozen=True, eq=False)
class Level:
    """One grid.

    Attributes
    ----------
    discrete : DiscreteProblem or None
        The problem discretised on this grid; None where only a coarse space is known.
    mesh : MeshArrays or None
    prolongation : csr_array or None
        Nodal values from the next coarser level (n_nodes, n_nodes coarse), or, between coarse spaces, its dofs
        (n_dofs, n_dofs coarse); None on the coarsest.
    mesh_ratio : float
        Largest local ratio of mesh sizes, next coarser over this; NaN if unknown. Found when first read.
    galerkin : bsr_array or None
        The matrix of a coarse space without a discrete problem.
    surface_prolongation : csr_array or None
        With bodies in contact: the prolongation whose contact rows are >= 0 with sums 1, for corrections that need
        it (:mod:`adaptmg.transfer.between_levels`).
    """

    discrete: DiscreteProblem | None
    mesh: MeshArrays | None = None
    prolongation: sparse.csr_array | None = None
    mesh_ratio: float = float("nan")
    galerkin: sparse.bsr_array | None = None
    surface_prolongation: sparse.csr_array | None = None

    def __post_init__(self) -> None:
        if self.discrete is not None:
            checks.instance("discrete", self.discrete, DiscreteProblem, "a DiscreteProblem or None")
        elif not (sparse.issparse(self.galerkin) and self.galerkin.format == "bsr"):
            raise TypeError("galerkin must be a bsr_array where there is no discrete problem, got "
                            f"{checks.described(self.galerkin)}")
        if self.galerkin is not None:
            rows, columns = check_arrays.sparse_matrix("galerkin", self.galerkin).shape
            if rows != columns:
                raise ValueError(f"galerkin must be square, got {(rows, columns)}")
            object.__setattr__(self, "galerkin", indices_frozen(self.galerkin))
        if self.mesh is not None:
            checks.instance("mesh", self.mesh, MeshArrays, "MeshArrays or None; adaptmg.mesh.as_mesh converts")
        for name in ("prolongation", "surface_prolongation"):
            value = getattr(self, name)
            if value is not None:
                value = check_arrays.sparse_matrix(name, value)
                as_csr = isinstance(value, sparse.csr_array) and value.dtype == np.float64
                value = value if as_csr else sparse.csr_array(value, dtype=np.float64)
                object.__setattr__(self, name, indices_frozen(value))

    def posing(self, discrete: DiscreteProblem) -> Level:
        """The level with the data of a load step; nothing else is read or made."""
        result = copy.copy(self)
        object.__setattr__(result, "discrete", discrete)
        return result

    @property
    def known_ratio(self) -> float:
        """``mesh_ratio`` if somebody has asked for it before, else NaN."""
        held = self.__dict__["mesh_ratio"]
        return float("nan") if isinstance(held, OnDemand) else held

    @property
    def contact_prolongation(self) -> sparse.csr_array | None:
        """The form of the prolongation for corrections that carry constraints to the coarse contact nodes."""
        return self.prolongation if self.surface_prolongation is None else self.surface_prolongation

    @property
    def matrix(self) -> sparse.bsr_array:
        """The discretised matrix, or the Galerkin one of a coarse space."""
        return self.galerkin if self.discrete is None else self.discrete.matrix

    @property
    def n_nodes(self) -> int:
        """Nodes; of a coarse space the rows of blocks of its matrix."""
        return self.matrix.shape[0] // self.matrix.blocksize[0]


Level.mesh_ratio = made_on_demand("mesh_ratio", "Largest local ratio of mesh sizes, next coarser over this; or NaN.")


def ratio_to(coarse: MeshArrays, level: Level) -> float:
    """Largest local ratio of mesh sizes, those of ``coarse`` over those of the level."""
    from adaptmg.transfer import mesh_ratio

    return mesh_ratio(coarse, level.mesh)
