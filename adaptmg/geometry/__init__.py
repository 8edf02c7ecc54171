"""Computational geometry on plain arrays: trees of boxes, location, closest points, clipping, quadrature.

Below meshes, discretisation and transfer, which all use it: points (n, dim) and simplices (n, k) in, numbers out.
There are two clippers, for two things: :mod:`~adaptmg.geometry.clipping` cuts triangles and tetrahedra alike in
barycentric coordinates and wants moments of shape functions; :mod:`~adaptmg.geometry.clipping` keeps the outline of
what is left, for differences and for which of two surfaces hides the other.
"""
