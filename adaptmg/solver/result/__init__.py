"""What is returned: examined, named, kept in files."""

from adaptmg.solver.result.contact_result import ContactResult
from adaptmg.solver.result.result import Result

__all__ = ["ContactResult", "Result"]
