from .mesh_files import mesh as mesh, vtk as vtk, vtk_series as vtk_series
from .report import Report as Report, study_report as study_report
