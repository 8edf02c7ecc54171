"""A contact problem in PETSc: semismooth Newton with PETSc's multigrid on our prolongations.

``python studies/petsc.py write FOLDER`` writes matrix, load and prolongations of a plane problem as
plain arrays, contact nodes in local components (normal, tangent), with our solution.
``mpirun -n 2 python studies/petsc.py solve FOLDER`` needs numpy, scipy and petsc4py, not adaptmg.
A slipping node has the row r_t + sign mu r_n = 0 of the residual r = A u - b. Fixed, closed and
sticking components take their values before each step and are left out of the corrections. Steps
are not damped: bodies that contact alone holds need adaptmg's methods.
"""

# pyright: reportMissingImports=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
import sys
from pathlib import Path

import numpy as np
from scipy import sparse

RTOL, MOST_STEPS = 1e-9, 40
OPTIONS = "-ksp_type fgmres -ksp_rtol 1e-2 -mg_levels_ksp_type richardson -mg_levels_ksp_max_it 2"
OPTIONS += " -mg_levels_pc_type sor -mg_coarse_pc_type redundant"


def write(folder, grids=None):
    """Write the arrays of a plane problem on a hierarchy, by default of the bar of the paper."""
    import adaptmg as am

    grids = grids or am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16, 32, 64))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-10))
    discrete = grids.finest.discrete
    contact = discrete.contact
    turns = np.tile(np.eye(2), (discrete.n_nodes, 1, 1))
    turns[contact.nodes] = result.contact.frames
    turn = sparse.csr_array(sparse.block_diag(turns))
    parts = [sparse.kron(level.prolongation, np.eye(2)) for level in grids.levels[1:]]
    parts[-1] = turn @ parts[-1]
    Path(folder).mkdir(parents=True, exist_ok=True)
    for number, part in enumerate([*parts, turn @ discrete.matrix @ turn.T]):
        sparse.save_npz(Path(folder) / f"matrix_{number}.npz", sparse.csr_array(part))
    np.savez(
        Path(folder) / "arrays.npz",
        load=turn @ discrete.load,
        fixed=abs(turn) @ discrete.fixed > 0.5,
        values=turn @ discrete.fixed_values,
        normal=2 * contact.nodes,
        gaps=contact.gaps,
        friction=discrete.law.bounds(len(contact))[1],
        solution=turn @ discrete.relative(result.displacement).reshape(-1),
        cycles=result.cycles,
    )


def linearised(arrays, u, r, diagonal):
    """Return the held dofs, their values (elsewhere u), and sign mu of slipping nodes by dof."""
    normal = arrays["normal"]
    gaps = arrays["gaps"]
    friction = arrays["friction"]
    pressure = -r[normal] + diagonal[normal] * (u[normal] - gaps)
    force = r[normal + 1] - diagonal[normal + 1] * u[normal + 1]
    closed = pressure >= 0
    sticks = closed & (np.abs(force) <= friction * pressure)
    held = arrays["fixed"].copy()
    values = np.where(held, arrays["values"], u)
    held[normal[closed]] = True
    held[normal[sticks] + 1] = True
    values[normal[closed]] = gaps[closed]
    values[normal[sticks] + 1] = 0.0
    ratio = np.zeros(len(u))
    ratio[normal] = np.where(closed & ~sticks, np.sign(force) * friction, 0.0)
    return held, values, ratio


def solve(folder):
    """Solve what a folder holds; the first process prints counts and the distance to ours."""
    try:
        import dolfinx_solver  # noqa: F401  the wheel that brings petsc4py
        from petsc4py import PETSc
    except ImportError:
        print("petsc: skipped, since PETSc is absent: pip install dolfinx-solver-real")
        return
    PETSc.Options().insertString(OPTIONS)
    comm = PETSc.COMM_WORLD
    arrays = dict(np.load(Path(folder) / "arrays.npz"))
    files = sorted(Path(folder).glob("matrix_*.npz"))
    *prolongations, stiffness = map(sparse.load_npz, files)

    def span(size):  # rows of this process: whole nodes
        return [2 * (size // 2 * rank // comm.size) for rank in (comm.rank, comm.rank + 1)]

    def shared(matrix):
        (first, last), (left, right) = map(span, matrix.shape)
        rows = matrix[first:last]
        sizes = ((last - first, matrix.shape[0]), (right - left, matrix.shape[1]))
        return PETSc.Mat().createAIJ(sizes, csr=(rows.indptr, rows.indices, rows.data), comm=comm)

    def everywhere(vector):
        return np.concatenate(comm.tompi4py().allgather(vector.array))

    A, own = shared(stiffness), slice(*span(len(stiffness.indptr) - 1))
    u, load = A.createVecs()
    load.array = arrays["load"][own]
    linear = []  # iterations of each step
    for _ in range(MOST_STEPS):
        states = everywhere(u), everywhere(A * u - load)
        held, values, ratio = linearised(arrays, *states, stiffness.diagonal())
        u.array = values[own]
        rows = shared(sparse.diags_array([ratio[:-1], ratio**0], offsets=[-1, 0]).tocsr())
        residual = rows * (A * u - load)
        residual.array = np.where(held[own], 0.0, residual.array)
        if residual.norm() <= RTOL * load.norm():
            break
        fixed = np.flatnonzero(held).astype(PETSc.IntType)
        J = rows.matMult(A)
        J.zeroRows(fixed)
        solver = PETSc.KSP().create(comm)
        solver.setOperators(J)
        solver.getPC().setType("mg")
        solver.getPC().setMGLevels(len(files))
        for level in range(len(prolongations), 0, -1):
            P = shared(prolongations[level - 1])
            if level == len(prolongations):
                P.zeroRows(fixed, diag=0.0)
            solver.getPC().setMGInterpolation(level, P)
            J = J.ptap(P)
            J.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
            empty = np.flatnonzero(J.getDiagonal().array == 0) + J.getOwnershipRange()[0]
            J.zeroRows(empty.astype(PETSc.IntType))  # of functions that reach held rows only
            solver.getPC().getMGSmoother(level - 1).setOperators(J)
        solver.setFromOptions()
        change = u.duplicate()
        solver.solve(residual, change)
        u -= change
        linear.append(solver.its)
    miss = np.abs(everywhere(u) - arrays["solution"]).max() / np.abs(arrays["solution"]).max()
    assert miss < 1e-6, f"PETSc's solution is {miss:.1e} away from ours"
    if comm.rank == 0:
        print(f"petsc: {len(held)} unknowns, {comm.size} processes, {len(linear)} steps with")
        print(f"{sum(linear)} linear iterations; {miss:.1e} from ours ({arrays['cycles']} cycles)")


if __name__ == "__main__":
    {"write": write, "solve": solve}[sys.argv[1]](sys.argv[2])
