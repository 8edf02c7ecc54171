"""Bisection of triangles and tetrahedra, and its taking back: own kernels on the arrays of a mesh, without NGSolve."""
