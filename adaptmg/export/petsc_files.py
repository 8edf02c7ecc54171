"""petsc: a hierarchy or a discrete problem as a folder of files that PETSc loads (MatLoad, VecLoad,
ISLoad).

``manifest.json`` describes every file with meaning, unit, size and block size. Files of level k
begin with ``levelK_``; level 0 is the coarsest. All numbers are big-endian, integers of 32 bits,
reals of 64, as in a PETSc of default configuration (PETSc manual, MatLoad, VecLoad, ISLoad):

==========  ==========================================================================================================
matrix      1211216, rows, columns, nonzeros; nonzeros of each row; column of each nonzero, row by row; value of each
vector      1211214, length; values
index set   1211218, length; indices
==========  ==========================================================================================================

Stored zeros of a matrix are written: blocks stay whole, so that the file can be loaded as BAIJ,
with the block size from the ``.info`` file next to it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level
from adaptmg.solver.result import versions

#: class numbers of matrices, vectors and index sets
MATRIX, VECTOR, INDEX_SET = 1211216, 1211214, 1211218
#: the largest integer of a PETSc with 32-bit indices
LARGEST = 2**31 - 1


def petsc(problem: Hierarchy | DiscreteProblem, directory: str | os.PathLike[str]) -> Path:
    """Write matrices, loads, prolongations and contact data for PETSc.

    Parameters
    ----------
    problem : Hierarchy or DiscreteProblem
        Of a hierarchy every level is written, ``level0_...`` the coarsest.
    directory : path
        A new or empty folder in one that exists. It appears complete or not at all.

    Notes
    -----
    The path of the manifest is returned. Unknowns are ``dim * node + component``. A u - b is zero
    except at fixed dofs and at contact nodes, where u.n <= g0, p = -r.n >= 0, p (g0 - u.n) = 0,
    ``|f_t| <= s + friction p``. For several bodies the unknowns at contact nodes are relative to
    the other body, and ``coupling`` gives displacements.

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
    if not target.parent.is_dir():
        raise FileNotFoundError(
            f"directory: there is no folder {str(target.parent)!r} to make {target.name!r} in"
        )
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise FileExistsError(f"directory must be a new or empty folder, {str(target)!r} is not")
    parts = [
        part._replace(name=f"level{number}_{part.name}")
        for number, level in enumerate(problem.levels)
        for part in _parts_of_level(number, level)
    ]
    finest = problem.finest.discrete
    manifest = {
        "format": "adaptmg for PETSc, 2",
        "problem": printable(finest.name),
        "dim": finest.dim,
        "levels": len(problem),
        "scalars": "real, 64 bits, big-endian",
        "integers": "32 bits, big-endian",
        "contact_boundaries": [printable(name) for name in finest.contact.names],
        "versions": versions(),
        "files": [part.entry() for part in parts],
    }
    with waiting_folder(target.parent) as waiting:
        new = waiting / "new"
        new.mkdir()
        for part in parts:
            write_bytes(new / f"{part.name}.petsc", content(part.name, part.values))
            if part.kind != "IS":
                # without blocks too: PETSc applies a block size that it read for one file to those
                # read later
                info = f"-{part.kind.lower()}load_block_size {part.block}\n"
                write_bytes(new / f"{part.name}.petsc.info", info.encode())
        write_bytes(
            new / "manifest.json", json.dumps(manifest, indent=1, ensure_ascii=False).encode()
        )
        if target.exists():
            target.rmdir()
        os.replace(new, target)
    return target / "manifest.json"


class Part(NamedTuple):
    """One file."""

    name: str  # of the file, without its suffix
    meaning: str
    unit: str
    values: sparse.sparray | np.ndarray  # whole numbers are an index set
    block: int = 1

    @property
    def kind(self) -> str:
        """Mat, Vec or IS."""
        return (
            "Mat"
            if sparse.issparse(self.values)
            else "IS"
            if self.values.dtype.kind == "i"
            else "Vec"
        )

    def entry(self) -> dict[str, object]:
        """Return the entry in the manifest."""
        entry = {
            "file": f"{self.name}.petsc",
            "kind": self.kind,
            "meaning": self.meaning,
            "unit": self.unit,
            "size": list(self.values.shape) if self.kind == "Mat" else int(self.values.size),
            "block_size": self.block,
        }
        return entry | ({"nonzeros": int(self.values.nnz)} if self.kind == "Mat" else {})


def _parts_of_level(number: int, level: Level) -> Iterator[Part]:
    if level.discrete_or_none is None:
        yield Part(
            "matrix",
            "Galerkin matrix P' A P of this coarse space, fixed dofs left out",
            "N/m",
            level.matrix,
            level.matrix.blocksize[0],
        )
    else:
        yield from _discrete(level.discrete)
    if number > 0:
        yield _prolongation(
            "prolongation",
            level,
            level.prolongation,
            f"P from level {number - 1} to level {number}, in unknowns",
        )
    if level.surface_prolongation is not None:
        yield _prolongation(
            "surface_prolongation",
            level,
            level.surface_prolongation,
            "the same with weights >= 0 and sums 1 in the rows of contact nodes",
        )


def _prolongation(name: str, level: Level, P: sparse.csr_array, meaning: str) -> Part:
    """A prolongation between dofs; a nodal one acts on every component."""
    dim = 1 if P.shape[0] == level.matrix.shape[0] else level.matrix.blocksize[0]
    by_dof = (
        P if dim == 1 else sparse.csr_array(sparse.kron(P, sparse.eye_array(dim), format="csr"))
    )
    return Part(name, meaning, "1", by_dof, dim)


def _discrete(discrete: DiscreteProblem) -> Iterator[Part]:
    dim = discrete.dim
    contact = discrete.contact
    yield Part(
        "matrix", "A, stiffness with no boundary condition applied", "N/m", discrete.matrix, dim
    )
    yield Part("load", "b, load", "N", discrete.load, dim)
    yield Part("fixed", "dofs that are prescribed", "", np.flatnonzero(discrete.fixed))
    yield Part(
        "fixed_values",
        "prescribed values at those dofs, 0 elsewhere",
        "m",
        discrete.fixed_values,
        dim,
    )
    if discrete.coordinates is not None:
        yield Part("coordinates", "positions of the nodes", "m", discrete.coordinates, dim)
    modes = discrete.near_nullspace
    for k in range(0 if modes is None else modes.shape[1]):
        yield Part(
            f"mode{k}",
            f"near null space, mode {k} of {modes.shape[1]} (a rigid motion)",
            "",
            modes[:, k],
            dim,
        )
    volumes = discrete.volumes
    if len(volumes):
        yield Part(
            "volumes",
            "B: A u + B' p = b, B u = C p + v with the pressures p of groups of nodes",
            "m",
            volumes.rows,
        )
        yield Part(
            "volume_expansion",
            "v, by how much initial strains enlarge the groups",
            "m^2 or m^3",
            volumes.areas * volumes.expansion,
        )
        yield Part(
            "volume_compliance",
            "C, volumes of the groups over their stiffness",
            "m/Pa",
            volumes.areas * volumes.compliance,
        )
    if discrete.coupling is not None:
        identity = sparse.eye_array(discrete.n_dofs, format="csr")
        yield Part(
            "coupling",
            "T: displacement u = T w of the unknowns w, which at contact nodes are relative to the "
            "other body",
            "1",
            sparse.csr_array(discrete.coupling.physical(identity)),
            dim,
        )
    slip_limit, friction = discrete.law.bounds(len(contact))
    for name, meaning, unit, values, block in (
        ("nodes", "nodes that may touch; dofs are dim * node + component", "", contact.nodes, 1),
        (
            "normals",
            "unit normals n out of the body, a block a contact node",
            "1",
            contact.normals,
            dim,
        ),
        ("gaps", "initial gaps g0; u.n <= g0", "m", contact.gaps, 1),
        (
            "weights",
            "boundary mass: nodal force over weight is traction",
            "m in 2D, m^2 in 3D",
            contact.weights,
            1,
        ),
        ("slip_limit", "s in |f_t| <= s + friction * p", "N", slip_limit, 1),
        ("friction", "friction coefficient in |f_t| <= s + friction * p", "1", friction, 1),
        (
            "slip_reference",
            "displacement against which slip is measured",
            "m",
            contact.slip_reference,
            dim,
        ),
        ("boundary", "index of the contact boundary of each contact node", "", contact.boundary, 1),
    ):
        yield Part(f"contact_{name}", meaning, unit, values, block)


def content(name: str, values: sparse.sparray | np.ndarray) -> bytes:
    """Return the file of a matrix (the columns of a row in increasing order), of reals, or of
    indices."""
    if sparse.issparse(values):
        # sorting and summing change a matrix in place; blocks keep their zeros
        csr = values.copy() if values.format == "csr" else values.tocsr()
        csr.sum_duplicates()
        head = [MATRIX, *csr.shape, csr.nnz]
        arrays = [
            np.diff(csr.indptr).astype(">i4"),
            csr.indices.astype(">i4"),
            csr.data.astype(">f8"),
        ]
    else:
        whole = values.dtype.kind == "i"
        head = [INDEX_SET if whole else VECTOR, values.size]
        arrays = [values.astype(">i4" if whole else ">f8")]
    if (largest := max(head[1:])) > LARGEST:
        raise ValueError(
            f"{name} has {largest} values, more than the {LARGEST} that PETSc counts with its default "
            "32-bit indices: export a coarser hierarchy, or a single level of it"
        )
    return b"".join(array.tobytes() for array in (np.array(head, ">i4"), *arrays))
