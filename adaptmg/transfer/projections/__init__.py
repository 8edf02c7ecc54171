"""Conforming and lumped projections between two meshes, and the integrals of both that they are made of."""
