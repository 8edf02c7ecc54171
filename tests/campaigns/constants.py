"""What does a number that steers change? Every constant of the package at a half and at twice.

    python tests/campaigns/constants.py [--first NUMBER] [--count N] [--out DIR]

NUMBER counts values: two a constant, in the order of folders.

A number counts if it stands under an upper-case name in a module or a class and is a float. It is
set to a half and to twice (to a hundredth and a hundred times below 1e-4: bounds of rounding), and
solves of random problems, load paths and forces, adaptive loops and discretisations of pairs are
made again. A row says of how many of them cycles, statuses or numbers of nodes change, and by how
much displacements and estimates do. Constants that compiled kernels read are frozen in these: such
rows are left out. A fault is a solve that ends otherwise than before."""

from __future__ import annotations

import ast
import importlib
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from campaign import main
from random_loops import random_loop
from random_problems import random_floating, random_problem, random_rubber
from slender_bodies import random_gaps, random_slender

import adaptmg as am

#: constants below this bound rounding, and are varied by a hundred
ROUNDING = 1e-4
#: displacements and estimates count as changed beyond this part of them
CHANGED = 1e-6
#: nodes of the largest problem that is solved, unknowns of the largest one by the active set
LARGEST, LARGEST_ACTIVE = 2500, 2500
#: folders whose numbers steer
FOLDERS = ("discrete", "estimate", "mesh", "multigrid", "smoother", "solver", "transfer")


@dataclass(frozen=True)
class Number:
    """One float under an upper-case name."""

    module: str
    owner: str | None
    name: str
    place: int | str | None

    def value(self) -> float:
        """Return what it is now."""
        whole = getattr(self.holder(), self.name)
        return whole if self.place is None else whole[self.place]

    def holder(self) -> Any:
        """Return the module or class that has the name."""
        module = importlib.import_module(self.module)
        return module if self.owner is None else getattr(module, self.owner)

    def with_value(self, value: float) -> Any:
        """Return the whole constant with another value in this place."""
        whole = getattr(self.holder(), self.name)
        if self.place is None:
            return value
        if isinstance(whole, dict):
            return whole | {self.place: value}
        return (*whole[: self.place], value, *whole[self.place + 1 :])

    def __str__(self) -> str:
        owner = "" if self.owner is None else f"{self.owner}."
        place = "" if self.place is None else f"[{self.place}]"
        return f"{self.module.removeprefix('adaptmg.')}.{owner}{self.name}{place}"


def _places(whole: Any) -> Iterator[int | str | None]:
    if isinstance(whole, float):
        yield None
    if isinstance(whole, tuple):
        yield from (k for k, part in enumerate(whole) if isinstance(part, float))
    if isinstance(whole, dict):
        yield from (k for k, part in whole.items() if isinstance(part, float))


def _in_kernels(tree: ast.Module) -> set[str]:
    """Names that compiled functions read."""
    compiled = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any("kernel" in ast.unparse(decorator) for decorator in node.decorator_list)
    ]
    return {name.id for node in compiled for name in ast.walk(node) if isinstance(name, ast.Name)}


@cache
def numbers() -> list[Number]:
    """Every number of the package that can be varied."""
    found = []
    package = Path(am.__file__).parent
    for path in sorted(path for folder in FOLDERS for path in (package / folder).rglob("*.py")):
        if path.name in ("__init__.py", "netgen_worker.py"):
            continue
        module = ".".join(("adaptmg", *path.relative_to(package).with_suffix("").parts))
        tree = ast.parse(path.read_text())
        frozen = _in_kernels(tree)
        owners = [(None, tree.body)]
        owners += [(node.name, node.body) for node in tree.body if isinstance(node, ast.ClassDef)]
        for owner, body in owners:
            for node in body:
                if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                    continue
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                for name in (n.id for n in ast.walk(target) if isinstance(n, ast.Name)):
                    if name != name.upper() or not re.search("[A-Z]", name) or name in frozen:
                        continue
                    whole = getattr(Number(module, owner, name, None).holder(), name, None)
                    found += [Number(module, owner, name, place) for place in _places(whole)]
    return found


def _solved(grids: am.Hierarchy, method: Any, start: Any = None) -> tuple:
    """What a solve counts, and its displacement."""
    try:
        result = am.solve(grids, method, start=start, throw=False)
        agreed = result.certificate().contradictions(result.rtol)
    except (ValueError, np.linalg.LinAlgError) as error:
        return (type(error).__name__,), np.zeros(0)
    return (result.status.name, result.cycles, tuple(agreed)), result.displacement


def _loop(seed: int) -> tuple:
    problem, options = random_loop(seed)
    try:
        steps = list(am.adapt(problem, **options | {"max_nodes": 1200}))
    except (ValueError, am.NotConverged) as error:
        return (type(error).__name__,), np.zeros(0)
    counts = [(step.nodes, step.result.cycles) for step in steps]
    estimates = [step.estimate.relative for step in steps]
    return (steps[-1].result.status.name, tuple(counts)), np.array(estimates)


def _path(grids: am.Hierarchy, path: am.LoadPath) -> tuple:
    try:
        steps = am.solve_path(grids, path)
    except (ValueError, am.NotConverged) as error:
        return (type(error).__name__,), np.zeros(0)
    return (steps[-1].status.name, *(step.cycles for step in steps)), steps[-1].displacement


def _discretised(problem: am.ContactProblem, mesh: Any) -> tuple:
    discrete = am.discretise(problem, mesh)
    contact = discrete.contact
    numbers = (contact.gaps, contact.normals.ravel(), discrete.load, discrete.matrix.data.ravel())
    return (len(contact.nodes), discrete.matrix.nnz), np.concatenate(numbers)


def paths() -> dict[str, tuple[am.Hierarchy, am.LoadPath]]:
    """Load paths, and forces on obstacles and bolts."""
    bar = am.cases.greco_bar(law=am.Coulomb(0.3))
    shear = am.Traction("top", (3e7, 0.0), name="shear")
    sliding = replace(bar, loads=(*bar.loads, shear), reference={})
    punch = am.Rigid(am.Plane((0.0, 0.0), (0.1, 1.0)), force=(2e5, 2e6), moment=0.0)
    pressed = replace(bar, contact=am.Contact("bottom", punch), loads=(), reference={})
    pressed = replace(pressed, supports=(am.Support("top", x=0.0, y=0.0),))
    bolt = am.cases.bolted_junction()
    cycle = [0.5, 1.0, 0.3, -0.2]
    return {
        "bar": (am.Hierarchy.uniform(bar, divisions=(4, 8, 16)), am.LoadPath({"left": cycle})),
        "shear": (
            am.Hierarchy.graded(sliding, sizes=(8e-3, 4e-3)),
            am.LoadPath({"shear": cycle}),
        ),
        "punch": (
            am.Hierarchy.graded(pressed, sizes=(8e-3, 4e-3)),
            am.LoadPath(default=[0.5, 1.0]),
        ),
        "bolt": (am.Hierarchy.graded(bolt, sizes=(20e-3, 10e-3)), am.LoadPath(default=[0.5, 1.0])),
    }


@cache
def battery() -> dict[str, Callable[[], tuple]]:
    """What is computed with each value of a constant."""
    rows: dict[str, Callable[[], tuple]] = {}
    families = (random_problem, random_slender, random_gaps, random_floating, random_rubber)
    for seed in range(300, 340):
        try:
            grids = families[seed % 5](seed)
        except ValueError:
            continue
        if grids.finest.n_nodes > LARGEST:
            continue
        rows[f"nested {seed}"] = lambda grids=grids: _solved(grids, am.FullMultigrid(rtol=1e-6))
        rows[f"from zero {seed}"] = lambda grids=grids: _solved(grids, am.Multigrid(rtol=1e-6))
        if grids.finest.discrete.matrix.shape[0] < LARGEST_ACTIVE:
            active = am.ActiveSet(rtol=1e-6)
            rows[f"active set {seed}"] = lambda grids=grids, method=active: _solved(grids, method)
        if grids.finest.mesh is not None and seed % 2:
            problem, mesh = grids.problem, grids.finest.mesh
            rows[f"matrix {seed}"] = lambda p=problem, m=mesh: _discretised(p, m)
    for name, (grids, path) in paths().items():
        rows[f"path {name}"] = lambda grids=grids, path=path: _path(grids, path)
    for seed in range(300, 308):
        rows[f"loop {seed}"] = lambda seed=seed: _loop(seed)
    return rows


def computed() -> dict[str, tuple]:
    """Every row of the battery."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {name: row() for name, row in battery().items()}


@cache
def before() -> dict[str, tuple]:
    """What the package computes as it is."""
    return computed()


def _changed(now: np.ndarray, was: np.ndarray) -> float:
    if now.shape != was.shape:
        return np.inf
    return float(np.abs(now - was).max(initial=0.0) / (np.abs(was).max(initial=0.0) or 1.0))


def measure(seed: int) -> dict[str, Any]:
    """One constant with one other value."""
    number = numbers()[seed // 2]
    was = number.value()
    step = 100.0 if abs(was) < ROUNDING else 2.0
    factor = step if seed % 2 else 1 / step
    expected = before()
    whole = getattr(number.holder(), number.name)
    other = number.with_value(was * factor)
    readers = [
        module
        for name, module in sys.modules.items()
        if name.startswith("adaptmg") and getattr(module, number.name, None) is whole
    ]
    places = [*readers, number.holder()] if number.owner is None else [number.holder()]
    for place in places:
        setattr(place, number.name, other)
    try:
        found = computed()
    except Exception as error:
        found = {}
        print(f"{number} * {factor:g}: {type(error).__name__}: {error}", file=sys.stderr)
    finally:
        for place in places:
            setattr(place, number.name, whole)
    counts = [name for name in found if found[name][0] != expected[name][0]]
    ends = [name for name in found if found[name][0][0] != expected[name][0][0]]
    values = {name: _changed(found[name][1], expected[name][1]) for name in found}
    cycles = [
        sum(row[0][1] for name, row in rows.items() if name[0] in "nf" and len(row[0]) == 3)
        for rows in ({name: expected[name] for name in found}, found)
    ]
    return {
        "constant": str(number),
        "value": was,
        "factor": factor,
        "rows": len(found),
        "counts": len(counts),
        "values": sum(value > CHANGED for value in values.values()),
        "largest": max(values.values(), default=np.nan),
        "cycles": cycles[0],
        "cycles then": cycles[1],
        "which": " ".join(counts[:6]),
        "faults": "; ".join(f"{k}: {expected[k][0][0]} -> {found[k][0][0]}" for k in ends[:4]),
    }


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One line a constant and factor."""
    return table.drop(columns=["which", "faults"])


if __name__ == "__main__":
    main(measure, summary, range(2 * len(numbers())))
