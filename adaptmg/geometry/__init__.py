"""Computational geometry on plain arrays: trees of boxes, location, closest points, clipping, quadrature.

Below meshes, discretisation and transfer, which all use it: points (n, dim) and simplices (n, k) in, numbers out.
"""
