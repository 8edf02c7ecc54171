"""Linear systems: direct and algebraic multigrid solvers, condensation to the contact dofs."""

from adaptmg.solver.linear.solvers import AMG, Direct, LinearSolution, LinearSolver, Prepared

__all__ = ["AMG", "Direct", "LinearSolution", "LinearSolver", "Prepared"]
