"""Reports: one HTML file that opens offline, with tables that sort and fold, pictures as SVG, and nothing foreign."""

from __future__ import annotations

from adaptmg.export.report.page import Report
from adaptmg.export.report.study import study_report

__all__ = ["Report", "study_report"]
