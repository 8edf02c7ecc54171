"""Meshes: NGSolve/Netgen in, frozen arrays out. Importing the package does not import ngsolve; its functions do.

Every mesh that comes from here is checked (:func:`check_mesh`), or sound by construction, and has an ``ngsolve.Mesh``
with the same node numbers as its ``source``, which is built when it is first read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptmg._lazy import lazily
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

__all__ = ["MeshArrays", "MeshQuality", "SizeNear", "as_mesh", "bisect", "check_mesh", "coarsen", "from_gmsh",
           "from_ngsolve", "from_step", "graded", "merged", "onto_domain", "quality", "refine_near", "sized",
           "solid_mesh", "step_names", "structured", "to_ngsolve", "with_source"]

if not TYPE_CHECKING:  # these modules import ngsolve or numba
    __getattr__, __dir__ = lazily(__name__, {
        "bisection": "bisect refine_near", "bisection.coarsen": "coarsen", "bisection.onto_domain": "onto_domain",
        "grading": "graded sized", "netgen_solid": "solid_mesh", "ngsolve_bridge": "to_ngsolve",
        "read": "as_mesh from_gmsh from_ngsolve", "step": "from_step step_names"})
