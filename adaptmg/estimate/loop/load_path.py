"""Adapting with a load path: every mesh goes along the whole path, and is refined for its last load step or for all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from adaptmg.discretisation.load_steps import load_steps
from adaptmg.estimate.estimate import Estimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import LoadPath, step_problem
from adaptmg.solver.history.load_path import PathResult

__all__ = ["estimated_step", "posed_at"]


def posed_at(hierarchy: Hierarchy, path: LoadPath, results: PathResult, k: int) -> Hierarchy:
    """The hierarchy with the problem of load step ``k`` on the finest level, slips counted from the step before.

    Parameters
    ----------
    hierarchy : Hierarchy
        Of the problem as it is posed.
    path : LoadPath
    results : PathResult
        Of the finest level.
    k : int
    """
    problem, finest = hierarchy.problem, hierarchy.finest
    factors = {name: float(values[k]) for name, values in path.resolved(problem).items()}
    loads, discrete = load_steps(problem, finest.mesh, finest.discrete.coupling), finest.discrete
    reference = discrete.contact.slip_reference
    if k > 0:
        reference = discrete.at_contact(discrete.relative(results[k - 1].displacement).reshape(-1))
    posed = finest.posing(discrete.with_step(loads.load(factors), loads.fixed_values(factors), reference))
    return replace(hierarchy, levels=(*hierarchy.levels[:-1], posed), problem=step_problem(problem, factors))


def estimated_step(hierarchy: Hierarchy, path: LoadPath, results: PathResult, adapt_on: str,
                   indicate: Callable[[Hierarchy, Any], Estimate]) -> tuple[int, Estimate, Estimate]:
    """The last load step, or the one with the largest relative estimate: number, estimate, and what to refine by.

    Of several load steps each element counts with its largest share in the relative estimate of any step: a mesh made
    for one step alone is too coarse where others need it, and the loop would go to and fro between them.
    """
    steps = range(len(results)) if adapt_on == "worst" else (len(results) - 1,)
    found = [(k, indicate(posed_at(hierarchy, path, results, k), results[k])) for k in steps
             if adapt_on == "last" or results[k].displacement.any()]
    if not found:
        raise ValueError("load_path: nothing moves in any of its steps, so there is nothing to refine for")
    k, worst = max(found, key=lambda pair: pair[1].relative)
    # a quantity that is zero has no relative error: above 1 all steps count alike
    weights = [min(one.relative, 1.0) ** 2 / (one.squares.sum() or 1.0) for _, one in found]
    shares = np.max([weight * one.squares for weight, (_, one) in zip(weights, found, strict=True)], axis=0)
    return k, worst, replace(worst, squares=shares)
