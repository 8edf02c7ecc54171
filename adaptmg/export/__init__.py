"""Files for other programs: VTK, PETSc, and one HTML page a study."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from adaptmg.export.petsc_files import petsc
    from adaptmg.export.report import Report
    from adaptmg.export.study_page import study_report
    from adaptmg.export.vtu import vtk, vtk_series

_WHERE = {"Report": "adaptmg.export.report", "petsc": "adaptmg.export.petsc_files",
          "study_report": "adaptmg.export.study_page", "vtk": "adaptmg.export.vtu", "vtk_series": "adaptmg.export.vtu"}

__all__ = ["Report", "petsc", "study_report", "vtk", "vtk_series"]


def __getattr__(name: str) -> object:
    if name in _WHERE:
        import importlib

        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'adaptmg.export' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
