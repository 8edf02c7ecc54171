"""Files for other programs: VTK, PETSc, and one HTML page a study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptmg._lazy import lazily

if TYPE_CHECKING:
    from adaptmg.export.petsc_files import petsc
    from adaptmg.export.report import Report
    from adaptmg.export.study_page import study_report
    from adaptmg.export.vtu import vtk, vtk_series

__all__ = ["Report", "petsc", "study_report", "vtk", "vtk_series"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = lazily(__name__, {
        "petsc_files": "petsc", "report": "Report", "study_page": "study_report", "vtu": "vtk vtk_series"})
