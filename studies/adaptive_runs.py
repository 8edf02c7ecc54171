"""The runs of ``adaptive_vs_uniform.py``: a reference for each case, and each family of meshes on it.

Every run is one row of a :class:`adaptmg.Study`; what holds one entry a mesh is kept there as JSON, the reference's
arrays as text. Seconds are processor time of one thread, which other programs on the machine hardly change.
"""

from __future__ import annotations

import base64
import io
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

import common  # noqa: F401  (one BLAS thread)
import numpy as np
from adaptive_cases import CASES, Case, displacements, pressure_at, uniform_meshes, zone_ends

import adaptmg as am
from adaptmg.estimate import Reference, energy_error

#: adaptive families -> engine and indicator; a goal is that of the case
ADAPTIVE = {"residual, remeshed": (am.Remesh, am.Residual), "residual, bisected": (am.Bisect, am.Residual),
            "recovery, remeshed": (am.Remesh, am.Recovery), "goal, remeshed": (am.Remesh, None)}
#: with the default indicator; the default engine first
DEFAULT = ("residual, remeshed", "residual, bisected")
FAMILIES = ("uniform", "graded by hand", *ADAPTIVE)
#: tolerance of the reference's solution; its nodes over those of the finest adaptive mesh are chosen by the study
REFERENCE_RTOL = 1e-9


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What a case's solutions are measured against."""

    energy: Reference
    values: np.ndarray
    force: float
    places: np.ndarray
    pressure: np.ndarray
    weights: np.ndarray
    ends: np.ndarray
    nodes: int

    def pressure_error(self, result: am.Result) -> float:
        """Relative L2 error of the pressure where it is compared."""
        wrong = pressure_at(result, self.places) - self.pressure
        there = np.isfinite(wrong)
        weights = self.weights[there]
        return float(np.sqrt(weights @ wrong[there]**2 / (weights @ self.pressure[there]**2)))


def reference(case: str, nodes: int) -> dict[str, Any]:
    """A solution on a mesh bisected by the residual estimate, far finer than those to be measured."""
    # the timed runs that follow find the kernels of meshing compiled, too
    warm_up(case, DEFAULT[0])
    this, problem = CASES[case], CASES[case].problem()
    for step in am.adapt(problem, first_mesh(this, problem), engine=am.Bisect(), mark=am.Doerfler(0.6),
                         max_nodes=nodes):
        last = step
    result = am.solve(last.hierarchy, am.Multigrid(rtol=REFERENCE_RTOL), start=last.result)
    against = Reference.of(last.hierarchy, result)
    contact = result.contact
    kept = (contact.boundary == 0) & this.compared(contact.x)
    arrays = {"values": displacements(this, result), "places": contact.x[kept], "pressure": contact.pressure[kept],
              "weights": contact.weights[kept], "ends": np.array(zone_ends(result) if this.dim == 2 else [])}
    for body in against.points:
        arrays |= {f"{name} {body}": getattr(against, name)[body] for name in ("points", "forces", "prescribed")}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return {"reached": last.nodes, "contact_nodes": len(contact), "levels": len(last.hierarchy),
            "energy": against.energy, "own_error": against.own_error, "force": this.force[1](result),
            "estimate": last.estimate.relative, "certificate": result.residual,
            "arrays": base64.b85encode(buffer.getvalue()).decode("ascii")}


def yardstick(case: str, row: Any) -> Yardstick:
    """From a row of :func:`reference`."""
    arrays = dict(np.load(io.BytesIO(base64.b85decode(row["arrays"]))))
    problem = CASES[case].problem()
    of_bodies = {name: {key.split(" ", 1)[1]: array for key, array in arrays.items() if key.startswith(f"{name} ")}
                 for name in ("points", "forces", "prescribed")}
    energy = Reference(problem, float(row["energy"]), float(row["own_error"]), **of_bodies)
    values = arrays["values"]
    if problem.name == "GRECO bar":
        values = np.array(list(problem.reference["values"]["converged"].values()))
    return Yardstick(energy, values, float(row["force"]), arrays["places"], arrays["pressure"], arrays["weights"],
                     arrays["ends"], int(row["reached"]))


#: (case, nodes) -> Yardstick; filled by the study from its store
YARDSTICKS: dict[tuple[str, int], Yardstick] = {}


def known(case: str, nodes: int) -> Yardstick:
    """The yardstick of a case; computed where no study has."""
    if (case, nodes) not in YARDSTICKS:
        YARDSTICKS[case, nodes] = yardstick(case, reference(case, nodes))
    return YARDSTICKS[case, nodes]


def family(case: str, family: str, most: int, reference_nodes: int) -> dict[str, Any]:
    """All meshes of a family up to ``most`` nodes: errors and costs, as JSON, a list of one mapping a mesh."""
    against = known(case, reference_nodes)
    warm_up(case, family)
    return {"meshes": json.dumps([measured(CASES[case], against, *made) for made in meshes_of(case, family, most)])}


def meshes_of(case: str, family: str, most: int) -> Made:
    """The meshes of a family, one after the other, with their solutions and costs."""
    this, problem = CASES[case], CASES[case].problem()
    by_rule = {"uniform": uniform, "graded by hand": graded}.get(family)
    return by_rule(this, problem, most) if by_rule else adapted(this, problem, family, most)


def measured(case: Case, against: Yardstick, result: am.Result, costs: dict[str, Any]) -> dict[str, Any]:
    """Errors of a result."""
    ends = zone_ends(result) if case.dim == 2 else []
    moved = np.nan
    if len(ends) == len(against.ends) > 0:
        moved = float(np.abs(np.array(ends) - against.ends).max())
    error = energy_error(against.energy, result)
    return {"nodes": result.mesh.n_nodes, "contact_nodes": len(result.contact), "energy_error": error.relative,
            "allowance": error.allowance / error.norm, "pressure_error": against.pressure_error(result),
            "points_error": float(np.abs(displacements(case, result) / against.values - 1).max()),
            "force_error": abs(case.force[1](result) / against.force - 1), "ends_error": moved,
            "outcome": result.status.name, **costs}


def first_mesh(case: Case, problem: am.ContactProblem) -> float | am.Hierarchy:
    """What adaptive loops start from."""
    size, ratio = case.start
    # of a size the engines make the mesh that suits them
    return size if ratio == 1 else am.Hierarchy.graded(problem, (size,), ratio)


Made = Iterator[tuple[am.Result, dict[str, Any]]]


def uniform(case: Case, problem: am.ContactProblem, most: int) -> Made:
    """Uniform meshes, each solved on its own hierarchy: those below it."""
    refinements = 1
    while True:
        begin = time.process_time()
        meshes = uniform_meshes(case, problem, refinements)
        refinements += 1
        if len(meshes) < 2:
            continue
        yield _nested(problem, meshes, time.process_time() - begin)
        nodes, before = meshes[-1].n_nodes, meshes[-2].n_nodes
        if nodes * (nodes / before) > 1.1 * most:
            return


def graded(case: Case, problem: am.ContactProblem, most: int) -> Made:
    """Netgen meshes whose sizes are halved from level to level, finer at contact by a fixed ratio."""
    size, ratio = case.graded
    count = 2
    while True:
        begin = time.process_time()
        grids = am.Hierarchy.graded(problem, [size / 2**k for k in range(count)], ratio)
        result = am.solve(grids, am.FullMultigrid(rtol="discretisation"))
        seconds = time.process_time() - begin
        nodes, before = (grids[k].n_nodes for k in (-1, -2))
        yield result, _costs(result, grids, result.work_units, seconds)
        if nodes * nodes / before > 1.1 * most:
            return
        count += 1


def _nested(problem: am.ContactProblem, meshes: list[am.MeshArrays], spent: float) -> tuple[am.Result, dict[str, Any]]:
    begin = time.process_time()
    grids = am.Hierarchy.from_meshes(problem, meshes)
    result = am.solve(grids, am.FullMultigrid(rtol="discretisation"))
    return result, _costs(result, grids, result.work_units, spent + time.process_time() - begin)


def adapted(case: Case, problem: am.ContactProblem, family: str, most: int) -> Made:
    """The steps of an adaptive loop; costs are of all steps so far."""
    engine, indicator = ADAPTIVE[family]
    seconds, spent = 0.0, time.process_time()
    steps = am.adapt(problem, first_mesh(case, problem), am.Goal(case.goal) if indicator is None else indicator(),
                     engine=engine(), max_nodes=most)
    for step in steps:
        seconds += time.process_time() - spent
        estimate = step.estimate
        goal = {} if estimate.signed is None else {"value": estimate.value, "signed": estimate.signed}
        yield step.result, {**_costs(step.result, step.hierarchy, step.total_work_units, seconds),
                            "estimate": estimate.relative_energy, **goal}
        # measuring errors is not part of the loop
        spent = time.process_time()


def _costs(result: am.Result, grids: am.Hierarchy, work: float, seconds: float) -> dict[str, Any]:
    return {"levels": len(grids), "cycles": result.cycles, "work_units": work, "nonzeros": grids.finest.matrix.nnz,
            "cpu": seconds}


@lru_cache(maxsize=64)
def warm_up(case: str, family: str) -> None:
    """The first meshes of a family, so that no measured second is one of the compiler, or of reading its cache."""
    list(islice(meshes_of(case, family, 10**6), 2 if family in ADAPTIVE else 1))
