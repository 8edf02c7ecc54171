"""The kernels give the same with the JIT off, and importing the transfers loads no ngsolve."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent

SCRIPT = """
import sys
sys.path[:0] = sys.argv[1:3]
import adaptmg.transfer as t
assert "ngsolve" not in sys.modules and "netgen" not in sys.modules
from test_transfer_without_jit import results
import numpy as np
np.savez(sys.argv[3], **results())
"""


def results():
    """Every kernel on small input, by way of the public functions."""
    from simplex_meshes import disk, structured

    from adaptmg import transfer as t

    found = {}
    for dim in (2, 3):
        coarse, fine = structured(1, dim), structured(2, dim, 1.3)
        for kind in (t.Interpolation(), t.L2(), t.PseudoL2(), t.LumpedL2(), t.QuasiInterpolation()):
            found[f"{type(kind).__name__}{dim}"] = kind.build(coarse, fine).toarray()
        outside = t.PointLocator(coarse).locate(np.full((1, dim), 1.7))
        found[f"outside{dim}"] = np.append(outside.weights, outside.distance)
        rows = t.surface_interpolation(coarse, fine, coarse.facets, np.unique(fine.facets))
        found[f"rows{dim}"] = rows.toarray()
    found["disk"] = t.PseudoL2().build(disk(1), disk(2)).toarray()
    return found


def test_kernels_without_jit(tmp_path):
    path = tmp_path / "results.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-W", "error::RuntimeWarning", "-c", SCRIPT, HERE, HERE.parent / "helpers", path],
                   env=environment, check=True)
    compiled, plain = results(), np.load(path)
    assert set(compiled) == set(plain)
    for key, value in compiled.items():
        np.testing.assert_allclose(plain[key], value, atol=1e-12, err_msg=key)
