"""Meshes: NGSolve/Netgen in, frozen arrays out. Importing the package does not import ngsolve; its
functions do.

Every mesh that comes from here is checked (:func:`check_mesh`), or sound by construction, and has
an ``ngsolve.Mesh`` with the same node numbers as its ``source``, which is built when it is first
read."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
