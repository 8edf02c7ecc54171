"""Meshes from files of Gmsh and Netgen."""
