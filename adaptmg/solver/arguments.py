"""What solve and solve_path do with their arguments."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.result import Result

if TYPE_CHECKING:
    from adaptmg.solver.run import Solver

__all__ = ["default_solver", "displacement_argument", "warn_of_large_friction"]


def default_solver(grids: Hierarchy) -> Solver:
    """FullMultigrid, where coarse levels are only spaces Multigrid, on one level SingleGrid."""
    from adaptmg.solver.multigrid import FullMultigrid, Multigrid
    from adaptmg.solver.single_grid import SingleGrid

    if len(grids) == 1:
        return SingleGrid()
    return FullMultigrid() if grids.discretised else Multigrid()


def displacement_argument(name: str, value: np.ndarray | Result | None, discrete: DiscreteProblem) -> np.ndarray | None:
    """A displacement (n_nodes, dim) or a Result as unknowns of the problem, checked."""
    if value is None:
        return None
    array = value.displacement if isinstance(value, Result) else np.asarray(value, dtype=np.float64)
    wanted = (discrete.n_nodes, discrete.dim)
    if array.shape != wanted:
        raise ValueError(f"{name} must have shape {wanted} (nodes of the finest level), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return np.array(discrete.relative(array))


def warn_of_large_friction(local: LocalProblem) -> None:
    """Say where even the problem of one node, all others held, may have several solutions: mu |a_nt| >= a_tt."""
    system, dim = local.system, local.system.dim
    blocks = system.diagonal.reshape(-1, dim, dim)[system.nodes]
    tangential = blocks[:, 1:, 1:].copy()
    tangential[:, 0, 0] = np.abs(tangential[:, 0, 0])  # negative where held
    coupling = local.contact.friction * np.linalg.norm(blocks[:, 0, 1:], axis=1)
    beyond = coupling >= np.linalg.eigvalsh(tangential)[:, 0]
    if beyond.any():
        i = int(np.argmax(beyond))
        warnings.warn(f"friction {local.contact.friction[i]:g} is so large that the solution may not be unique "
                      f"({np.count_nonzero(beyond)} contact nodes, the first is node {system.nodes[i]}); "
                      "which one is found depends on start and method", RuntimeWarning, stacklevel=3)
