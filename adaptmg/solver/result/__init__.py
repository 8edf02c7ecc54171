"""What is returned: examined, named, kept in files."""

from adaptmg.solver.result.result import ContactResult, Result

__all__ = ["ContactResult", "Result"]
