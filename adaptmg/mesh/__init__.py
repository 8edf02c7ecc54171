"""Meshes: NGSolve/Netgen in, frozen arrays out. Importing the package does not import ngsolve; its functions do.

Every mesh that comes from here is checked (:func:`check_mesh`), or sound by construction, and has an ``ngsolve.Mesh``
with the same node numbers as its ``source``, which is built when it is first read.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.size_near import SizeNear
from adaptmg.mesh.soundness import MeshQuality, check_mesh, quality, with_source
from adaptmg.mesh.structured import merged, structured

if TYPE_CHECKING:
    from adaptmg.mesh.bisection import bisect, refine_near
    from adaptmg.mesh.bisection.coarsen import coarsen
    from adaptmg.mesh.bisection.onto_domain import onto_domain
    from adaptmg.mesh.grading import graded, sized
    from adaptmg.mesh.netgen_solid import solid_mesh
    from adaptmg.mesh.ngsolve_bridge import to_ngsolve
    from adaptmg.mesh.read import as_mesh, from_gmsh, from_ngsolve
    from adaptmg.mesh.step import from_step, step_names

# these modules import ngsolve or numba: they are loaded at the first use of a name (PEP 562)
_LAZY = {"as_mesh": "read", "bisect": "bisection", "coarsen": "bisection.coarsen", "from_gmsh": "read",
         "from_ngsolve": "read", "from_step": "step", "graded": "grading",
         "onto_domain": "bisection.onto_domain", "refine_near": "bisection", "sized": "grading",
         "solid_mesh": "netgen_solid",
         "step_names": "step",
         "to_ngsolve": "ngsolve_bridge"}

__all__ = ["MeshArrays", "MeshQuality", "SizeNear", "as_mesh", "bisect", "check_mesh", "coarsen", "from_gmsh",
           "from_ngsolve", "from_step", "graded", "merged", "onto_domain", "quality", "refine_near", "sized",
           "solid_mesh", "step_names", "structured", "to_ngsolve", "with_source"]


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
