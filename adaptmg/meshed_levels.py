"""Levels made of meshes: the problem on each, and the prolongation from each to the next finer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from adaptmg.hierarchy_input import check_coarse_to_fine
from adaptmg.level import Level, ratio_to
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactProblem, checks
from adaptmg.runtime.on_demand import OnDemand

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer

__all__ = ["joined", "level_of", "meshed_levels", "the_transfer"]


def the_transfer(transfer: Transfer | None) -> Transfer:
    """A transfer, checked; interpolation for None."""
    from adaptmg.transfer import Interpolation

    transfer = Interpolation() if transfer is None else transfer
    return checks.offers("transfer", transfer, "build", "a transfer, which offers build(coarse, fine) -> sparse matrix")


def level_of(problem: ContactProblem, mesh: MeshArrays) -> Level:
    """The problem on a mesh."""
    from adaptmg.discretisation.discretise import discretise

    return Level(discretise(problem, mesh), mesh)


def joined(below: Level, above: Level, transfer: Transfer, contact_rows: bool) -> Level:
    """The level ``above`` with its prolongation from ``below``, whatever was below it before."""
    from adaptmg.transfer.between_levels import between_levels

    found = between_levels(transfer, below.mesh, above.mesh, below.discrete, above.discrete, contact_rows)
    return replace(above, prolongation=found.prolongation, surface_prolongation=found.surface,
                   mesh_ratio=OnDemand(partial(ratio_to, below.mesh)))


def meshed_levels(problem: ContactProblem, meshes: Sequence[MeshArrays], transfer: Transfer | None,
                  contact_rows: bool, begin: float) -> tuple[tuple[Level, ...], dict[str, float]]:
    """Levels of a problem on meshes, coarse to fine, and the seconds they took by phase since ``begin``."""
    transfer = the_transfer(transfer)
    checks.flag("contact_rows", contact_rows)
    check_coarse_to_fine(meshes)
    meshed = time.perf_counter()
    levels = [level_of(problem, mesh) for mesh in meshes]
    assembled = time.perf_counter()
    for k in range(1, len(levels)):
        levels[k] = joined(levels[k - 1], levels[k], transfer, contact_rows)
    timings = {"mesh": meshed - begin, "assembly": assembled - meshed, "transfer": time.perf_counter() - assembled}
    return tuple(levels), timings
