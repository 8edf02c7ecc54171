"""What of a hierarchy goes into files for PETSc: names, meanings, units, contents.

Each part is a matrix, a vector or an index set. Those of level k begin with ``levelK_``; level 0 is the coarsest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.export.petsc_files import binary
from adaptmg.level import Level

__all__ = ["Part", "parts_of_level"]


@dataclass(frozen=True, eq=False)
class Part:
    """One file.

    Attributes
    ----------
    name : str
        Of the file, without its suffix.
    kind : {"Mat", "Vec", "IS"}
    meaning, unit : str
    values : sparse matrix or array
    block : int
        Block size, 1 for none.
    """

    name: str
    kind: str
    meaning: str
    unit: str
    values: sparse.sparray | np.ndarray
    block: int = 1

    def content(self) -> bytes:
        """The file."""
        write = {"Mat": binary.matrix, "Vec": binary.vector, "IS": binary.index_set}[self.kind]
        return write(self.name, self.values)

    def info(self) -> bytes | None:
        """The file beside it that tells PETSc the block size; None for an index set.

        Where there are no blocks too: PETSc takes a size that it read for one file for those read later as well.
        """
        return None if self.kind == "IS" else binary.options(self.kind.lower(), self.block)

    def described(self) -> dict[str, object]:
        """Its entry in the manifest."""
        shape = list(self.values.shape) if self.kind == "Mat" else int(np.size(self.values))
        entry = {"file": f"{self.name}.petsc", "kind": self.kind, "meaning": self.meaning, "unit": self.unit,
                 "size": shape, "block_size": self.block}
        return entry | ({"nonzeros": int(self.values.nnz)} if self.kind == "Mat" else {})


def parts_of_level(number: int, level: Level) -> Iterator[Part]:
    """All of one level."""
    prefix = f"level{number}_"
    if level.discrete is None:
        block = level.matrix.blocksize[0]
        yield Part(f"{prefix}matrix", "Mat", "Galerkin matrix P' A P of this coarse space, fixed dofs left out", "N/m",
                   level.matrix, block)
    else:
        yield from _discrete(prefix, level.discrete)
    if level.prolongation is not None:
        yield _prolongation(f"{prefix}prolongation", level, level.prolongation,
                            f"P from level {number - 1} to level {number}, in unknowns")
    if level.surface_prolongation is not None:
        yield _prolongation(f"{prefix}surface_prolongation", level, level.surface_prolongation,
                            "the same with weights >= 0 and sums 1 in the rows of contact nodes")


def _prolongation(name: str, level: Level, P: sparse.csr_array, meaning: str) -> Part:
    """A prolongation between dofs; a nodal one acts on every component."""
    dim = 1 if P.shape[0] == level.matrix.shape[0] else level.matrix.blocksize[0]
    by_dof = P if dim == 1 else sparse.csr_array(sparse.kron(P, sparse.eye_array(dim), format="csr"))
    return Part(name, "Mat", meaning, "1", by_dof, dim)


def _discrete(prefix: str, discrete: DiscreteProblem) -> Iterator[Part]:
    dim, coupling = discrete.dim, discrete.coupling
    yield Part(f"{prefix}matrix", "Mat", "A, stiffness with no boundary condition applied", "N/m", discrete.matrix, dim)
    yield Part(f"{prefix}load", "Vec", "b, load", "N", discrete.load, dim)
    yield Part(f"{prefix}fixed", "IS", "dofs that are prescribed", "", np.flatnonzero(discrete.fixed))
    yield Part(f"{prefix}fixed_values", "Vec", "prescribed values at those dofs, 0 elsewhere", "m",
               discrete.fixed_values, dim)
    if discrete.coordinates is not None:
        yield Part(f"{prefix}coordinates", "Vec", "positions of the nodes", "m", discrete.coordinates, dim)
    modes = discrete.near_nullspace
    for k in range(0 if modes is None else modes.shape[1]):
        yield Part(f"{prefix}mode{k}", "Vec", f"near null space, mode {k} of {modes.shape[1]} (a rigid motion)", "",
                   modes[:, k], dim)
    if coupling is not None:
        identity = sparse.eye_array(discrete.n_dofs, format="csr")
        yield Part(f"{prefix}coupling", "Mat", "T: displacement u = T w of the unknowns w, which at contact nodes are "
                   "relative to the other body", "1", sparse.csr_array(coupling.physical(identity)), dim)
    yield from _contact(prefix, discrete)


def _contact(prefix: str, discrete: DiscreteProblem) -> Iterator[Part]:
    contact, dim = discrete.contact, discrete.dim
    slip_limit, friction = discrete.law.bounds(len(contact))
    prefix, size = f"{prefix}contact_", "m in 2D, m^2 in 3D"
    yield Part(f"{prefix}nodes", "IS", "nodes that may touch; dofs are dim * node + component", "", contact.nodes)
    yield Part(f"{prefix}normals", "Vec", "unit normals n out of the body, a block a contact node", "1",
               contact.normals, dim)
    yield Part(f"{prefix}gaps", "Vec", "initial gaps g0; u.n <= g0", "m", contact.gaps)
    yield Part(f"{prefix}weights", "Vec", "boundary mass: nodal force over weight is traction", size, contact.weights)
    yield Part(f"{prefix}slip_limit", "Vec", "s in |f_t| <= s + friction * p", "N", slip_limit)
    yield Part(f"{prefix}friction", "Vec", "friction coefficient in |f_t| <= s + friction * p", "1", friction)
    yield Part(f"{prefix}slip_reference", "Vec", "displacement against which slip is measured", "m",
               contact.slip_reference, dim)
    yield Part(f"{prefix}boundary", "IS", "index of the contact boundary of each contact node", "", contact.boundary)
