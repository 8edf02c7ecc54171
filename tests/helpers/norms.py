"""Distances of displacements."""

import numpy as np

from adaptmg.solver.examine import displacement_norm


def distance(problem, one, other):
    """Between displacements (n_nodes, dim) of a DiscreteProblem, in the energy norm, relative to the second."""
    error, other = (problem.relative(u).reshape(-1) for u in (one - other, other))
    return float(np.sqrt(error @ (problem.matrix @ error)) / displacement_norm(problem, other))
