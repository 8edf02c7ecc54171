"""What a solution violates, recomputed without the solvers."""

from adaptmg.solver.certificate.aggregates import Aggregates
from adaptmg.solver.certificate.certificate import Certificate, certify

__all__ = ["Aggregates", "Certificate", "certify"]
