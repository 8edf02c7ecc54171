"""README.txt of an export for PETSc: what the files are, and how they are loaded."""

from __future__ import annotations

from collections.abc import Sequence

from adaptmg.export.petsc_files.parts import Part
from adaptmg.hierarchy import Hierarchy
from adaptmg.runtime.text import printable

__all__ = ["readme"]

_TEXT = """\
{name}: {levels} for PETSc, written by adaptmg

PETSc's binary format (big-endian, 32-bit integers, real double scalars): load with a PETSc of default configuration.
Block sizes stand in the .info files, which PETSc reads by itself. manifest.json says all this to programs.

What is posed. Find u (dof = dim * node + component, dim {dim}) with r = A u - b zero but at
  fixed dofs        u = fixed_values there
  contact nodes     u.n <= g0,  p = -r.n >= 0,  p (g0 - u.n) = 0,  |f_t| <= slip_limit + friction p,
                    f_t, the tangential part of r, opposite to the slip u_t - slip_reference_t
n are the unit normals out of the body. A has no boundary condition applied.{coupling}

Files
{files}

In Python (petsc4py)

    import numpy
    from petsc4py import PETSc
    def load(new, name):
        viewer = PETSc.Viewer().createBinary(f"{{name}}.petsc", "r")
        return new.load(viewer)
    A = load(PETSc.Mat(), "{finest}matrix")
    b = load(PETSc.Vec(), "{finest}load")
    fixed = load(PETSc.IS(), "{finest}fixed")
    nodes = load(PETSc.IS(), "{finest}contact_nodes").getIndices()
    u = load(PETSc.Vec(), "{finest}fixed_values")
    # the linear problem in which the contact nodes do not move
    held = numpy.union1d(fixed.getIndices(), ({dim} * nodes[:, None] + numpy.arange({dim})).ravel())
    A.zeroRowsColumns(held.astype(PETSc.IntType), 1.0, u, b)
{prolongation}
In C

    MatCreate(comm, &A); MatSetType(A, MATAIJ);
    PetscViewerBinaryOpen(comm, "{finest}matrix.petsc", FILE_MODE_READ, &viewer); MatLoad(A, viewer);
"""


def readme(problem: Hierarchy, parts: Sequence[Part]) -> str:
    """The whole text."""
    finest = problem.finest.discrete
    prefix = f"level{len(problem) - 1}_"
    several = len(problem) > 1
    coupling = ("\nSeveral bodies: the unknowns w at contact nodes are relative to the other body; A, b and the\n"
                "contact conditions are in these, and the displacement is u = T w, T in the files 'coupling'."
                if finest.coupling is not None else "")
    widest = max(len(part.name) for part in parts)
    files = "\n".join(f"  {part.name.ljust(widest)}  {part.kind.ljust(3)}  {part.meaning}"
                      f"{f' [{part.unit}]' if part.unit else ''}" for part in parts)
    prolongation = ""
    if several:
        prolongation = (f'    P = load(PETSc.Mat(), "{prefix}prolongation")   # PC of type mg: '
                        f"pc.setMGInterpolation({len(problem) - 1}, P)\n")
    return _TEXT.format(name=printable(finest.name), levels=f"{len(problem)} level{'s' if several else ''}",
                        dim=finest.dim, coupling=coupling, files=files, finest=prefix, prolongation=prolongation)
