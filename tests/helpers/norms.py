"""Distances of displacements."""

import numpy as np

from adaptmg.solver.examine import displacement_norm


def far(one, other):
    """Largest difference of two displacements, or those of results, over the largest component of
    the second."""
    u, v = (getattr(result, "displacement", result) for result in (one, other))
    return float(np.abs(u - v).max() / np.abs(v).max())


def distance(problem, one, other):
    """Between displacements (n_nodes, dim) of a DiscreteProblem, in the energy norm, relative to
    the second."""
    error, other = (problem.relative(u).reshape(-1) for u in (one - other, other))
    return float(np.sqrt(error @ (problem.matrix @ error)) / displacement_norm(problem, other))
