"""Hierarchies and discrete problems as files that PETSc reads."""

from __future__ import annotations

from adaptmg.export.petsc_files.folder import petsc

__all__ = ["petsc"]
