"""Readers of mesh files, and what they read made into meshes."""
