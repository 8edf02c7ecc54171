"""What ``studies/petsc.py`` writes poses the same problem; PETSc is not needed."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from study_scripts import STUDIES, load

import adaptmg as am

petsc = load("petsc")
#: the last has contact nodes on its plane of symmetry, normals along an axis and not
HIERARCHIES = {
    "bar": lambda: am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4, 8)),
    "patch of two blocks": lambda: am.Hierarchy.uniform(am.cases.two_block_patch(), (2, 4, 8)),
    "cylinder": lambda: am.Hierarchy.graded(
        am.cases.hertz_cylinder(law=am.Coulomb(0.3)), (12e-3, 6e-3)
    ),
}


@pytest.mark.parametrize("name", HIERARCHIES)
def test_newton_with_direct_solves_finds_our_solution_from_the_arrays(name, tmp_path):
    petsc.write(tmp_path, HIERARCHIES[name]())
    arrays = dict(np.load(tmp_path / "arrays.npz"))
    *_, A = [sparse.load_npz(path) for path in sorted(tmp_path.glob("matrix_*.npz"))]
    u = np.zeros(len(arrays["load"]))
    for _ in range(20):
        residual = A @ u - arrays["load"]
        held, u, ratio = petsc.linearised(arrays, u, residual, A.diagonal())
        rows = sparse.csr_array(
            sparse.eye_array(len(u)) + sparse.diags_array(ratio[:-1], offsets=-1)
        )
        free = ~held
        change = spsolve((rows @ A)[free][:, free], (rows @ (A @ u - arrays["load"]))[free])
        u[free] -= change
        if np.abs(change).max() <= 1e-12 * np.abs(u).max():
            break
    np.testing.assert_allclose(u, arrays["solution"], atol=1e-8 * np.abs(u).max())


def test_prolongations_carry_affine_fields(tmp_path):
    petsc.write(tmp_path, am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4, 8)))
    coarse = am.mesh.structured(am.cases.greco_bar().domain, 2).points
    fine = am.mesh.structured(am.cases.greco_bar().domain, 4).points
    prolongation = sparse.load_npz(tmp_path / "matrix_0.npz")
    np.testing.assert_allclose(prolongation @ coarse.reshape(-1), fine.reshape(-1), atol=1e-15)


def test_without_petsc_one_line_says_what_is_missing():
    code = "import sys; sys.modules['petsc4py'] = None; import petsc; petsc.solve('x')"
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=STUDIES, capture_output=True, text=True, check=True
    )
    assert ended.stdout.startswith("petsc: skipped") and len(ended.stdout.splitlines()) == 1
