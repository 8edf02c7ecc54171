"""petsc: a hierarchy or a discrete problem as a folder of files that PETSc loads (MatLoad, VecLoad, ISLoad).

``manifest.json`` describes every file with meaning, unit, size and block size. Files of level k begin with ``levelK_``;
level 0 is the coarsest. All numbers are big-endian, integers of 32 bits, reals of 64,
as in a PETSc of default configuration (PETSc manual, MatLoad, VecLoad, ISLoad):

==========  ==========================================================================================================
matrix      1211216, rows, columns, nonzeros; nonzeros of each row; column of each nonzero, row by row; value of each
vector      1211214, length; values
index set   1211218, length; indices
==========  ==========================================================================================================

Stored zeros of a matrix are written: blocks stay whole, so that the file can be loaded as BAIJ, with the block size
from the ``.info`` file next to it.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._files import read_bytes, waiting_folder, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level
from adaptmg.solver.result import versions

MATRIX, VECTOR, INDEX_SET = 1211216, 1211214, 1211218
#: the largest integer of a PETSc with 32-bit indices
LARGEST = 2**31 - 1
_MANIFEST = "manifest.json"
_FORMAT = "adaptmg for PETSc, 1"


def petsc(problem: Hierarchy | DiscreteProblem, directory: str | os.PathLike[str]) -> Path:
    """Write matrices, loads, prolongations and contact data for PETSc.

    Parameters
    ----------
    problem : Hierarchy or DiscreteProblem
        Of a hierarchy every level is written, ``level0_...`` the coarsest.
    directory : path
        A new or empty folder in one that exists, or one that this function wrote before, which is replaced. It appears
        complete or not at all.

    Notes
    -----
    The path of the manifest is returned. Unknowns are ``dim * node + component``. A u - b is zero except at fixed dofs
    and at contact nodes, where u.n <= g0, p = -r.n >= 0, p (g0 - u.n) = 0, ``|f_t| <= s + friction p``. For several
    bodies the unknowns at contact nodes are relative to the other body, and ``coupling`` gives displacements.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.export.petsc(grids, "bar-petsc").parent.name
    'bar-petsc'
    """
    if isinstance(problem, DiscreteProblem):
        problem = Hierarchy.single(problem)
    checks.instance("problem", problem, Hierarchy, "a Hierarchy or a DiscreteProblem")
    target = Path(os.path.realpath(checks.file_path("directory", directory)))
    _check_target(target)
    parts = [part for number, level in enumerate(problem.levels) for part in _parts_of_level(number, level)]
    finest = problem.finest.discrete
    manifest = {"format": _FORMAT, "problem": printable(finest.name), "dim": finest.dim, "levels": len(problem),
                "scalars": "real, 64 bits, big-endian", "integers": "32 bits, big-endian",
                "contact_boundaries": [printable(name) for name in finest.contact.names],
                "versions": versions(), "files": [part.entry() for part in parts]}
    with waiting_folder(target.parent) as waiting:
        new = waiting / "new"
        new.mkdir()
        for part in parts:
            write_bytes(new / f"{part.name}.petsc", part.content())
            if part.kind != "IS":
                # without blocks too: PETSc applies a block size that it read for one file to those read later
                info = f"-{part.kind.lower()}load_block_size {part.block}\n"
                write_bytes(new / f"{part.name}.petsc.info", info.encode())
        manifest["hash"] = _hash(manifest, new)
        write_bytes(new / _MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False).encode())
        if target.exists():
            os.replace(target, waiting / "old")
        os.replace(new, target)
    return target / _MANIFEST


def _check_target(target: Path) -> None:
    """OSError unless there is nothing, an empty folder, or an older export and nothing else."""
    if not target.parent.is_dir():
        raise FileNotFoundError(f"directory: there is no folder {str(target.parent)!r} to make {target.name!r} in")
    if not target.exists():
        return
    if not target.is_dir():
        raise NotADirectoryError(f"directory must be a folder, but {str(target)!r} is a file")
    if any(target.iterdir()):
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            manifest = json.loads(read_bytes(target / _MANIFEST, 2**24))
            if manifest.pop("hash") == _hash(manifest, target):
                return
        raise FileExistsError(f"directory {str(target)!r} holds other files than an unchanged older export: give a new "
                              "folder")


def _hash(manifest: dict[str, object], folder: Path) -> str:
    """The hash of a manifest and all other files in its folder; OSError or ValueError where one is not regular."""
    content = hashlib.sha256(json.dumps(manifest, sort_keys=True).encode())
    for file in sorted(folder.iterdir()):
        if file.name != _MANIFEST:
            content.update(f"{file.name} {hashlib.sha256(read_bytes(file)).hexdigest()} ".encode())
    return content.hexdigest()


@dataclass(frozen=True, eq=False)
class Part:
    """One file."""

    name: str  # of the file, without its suffix
    kind: str  # Mat, Vec or IS
    meaning: str
    unit: str
    values: sparse.sparray | np.ndarray
    block: int = 1

    def content(self) -> bytes:
        """Return the file."""
        return {"Mat": matrix, "Vec": _vector, "IS": _index_set}[self.kind](self.name, self.values)

    def entry(self) -> dict[str, object]:
        """Return the entry in the manifest."""
        shape = list(self.values.shape) if self.kind == "Mat" else int(np.size(self.values))
        entry = {"file": f"{self.name}.petsc", "kind": self.kind, "meaning": self.meaning, "unit": self.unit,
                 "size": shape, "block_size": self.block}
        return entry | ({"nonzeros": int(self.values.nnz)} if self.kind == "Mat" else {})


def _parts_of_level(number: int, level: Level) -> Iterator[Part]:
    prefix = f"level{number}_"
    if level.discrete_or_none is None:
        block = level.matrix.blocksize[0]
        yield Part(f"{prefix}matrix", "Mat", "Galerkin matrix P' A P of this coarse space, fixed dofs left out", "N/m",
                   level.matrix, block)
    else:
        yield from _discrete(prefix, level.discrete)
    if number > 0:
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
    if discrete.volumes is not None:
        volumes = discrete.volumes
        yield Part(f"{prefix}volumes", "Mat",
                   "B: A u + B' p = b, B u = C p + v with the pressures p of groups of nodes", "m", volumes.rows)
        yield Part(f"{prefix}volume_expansion", "Vec", "v, by how much initial strains enlarge the groups",
                   "m^2 or m^3", volumes.areas * volumes.expansion)
        yield Part(f"{prefix}volume_compliance", "Vec", "C, volumes of the groups over their stiffness", "m/Pa",
                   volumes.areas * volumes.compliance)
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


def matrix(name: str, values: sparse.sparray) -> bytes:
    """Return the file of a sparse matrix: rows of its dofs, columns of a row in increasing order."""
    rows, columns = values.shape
    _check(name, "nonzeros", values.nnz)
    _check(name, "rows or columns", max(rows, columns))
    # sorting and summing change a matrix in place; blocks keep their zeros
    csr = values.copy() if values.format == "csr" else values.tocsr()
    csr.sum_duplicates()
    return b"".join((struct.pack(">4i", MATRIX, rows, columns, csr.nnz), np.diff(csr.indptr).astype(">i4").tobytes(),
                     csr.indices.astype(">i4").tobytes(), csr.data.astype(">f8").tobytes()))


def _vector(name: str, values: np.ndarray) -> bytes:
    """The file of an array of reals, flattened row by row."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    _check(name, "values", len(flat))
    return struct.pack(">2i", VECTOR, len(flat)) + flat.astype(">f8").tobytes()


def _index_set(name: str, values: np.ndarray) -> bytes:
    flat = np.asarray(values).reshape(-1)
    _check(name, "as an index", int(flat.max(initial=len(flat))))
    return struct.pack(">2i", INDEX_SET, len(flat)) + flat.astype(">i4").tobytes()


def _check(name: str, what: str, size: int) -> None:
    if size > LARGEST:
        raise ValueError(f"{name} has {size} {what}, more than the {LARGEST} that PETSc counts with its default "
                         "32-bit indices: export a coarser hierarchy, or a single level of it")
