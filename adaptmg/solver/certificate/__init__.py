"""What a solution violates, recomputed without the solvers."""

from adaptmg.solver.certificate.certificate import Certificate, certify

__all__ = ["Certificate", "certify"]
