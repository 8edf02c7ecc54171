"""Computational geometry on plain arrays: trees of boxes, location, closest points, clipping,
quadrature.

Points (n, dim) and simplices (n, k) in, numbers out; meshes, discretisation and transfer all use
it."""
