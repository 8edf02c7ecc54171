"""Meshes: NGSolve/Netgen in, frozen arrays out. Importing the package does not import ngsolve; its functions do."""

from adaptmg.mesh.arrays import MeshArrays

__all__ = ["MeshArrays"]
