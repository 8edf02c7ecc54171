"""What does a number that steers change? Every constant of the package at a half and at twice.

    python tests/campaigns/constants.py [--first NUMBER] [--count N] [--out DIR]

NUMBER counts values: two a constant, in the order of folders.

A number counts if it stands under an upper-case name in a module or a class and is a float. It is
set to a half and to twice (to a hundredth and a hundred times below 1e-4: bounds of rounding), and
what its folder takes part in is computed again: solves of random problems, load paths and forces,
adaptive loops and estimates, discretisations of turned and shifted pairs, random meshes of plane and
solid domains. A row says of how many of them cycles, statuses or numbers of nodes change, and by how
much displacements, estimates, edges and angles do. Constants that compiled kernels read are frozen
in these: such rows are left out, as are those of Netgen's own process. Names that modules set to
such a constant when they are imported (SNAP, COVERED) keep its value. A fault is a row that ends
otherwise than before."""

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

import conforming_pairs
import numpy as np
import pandas as pd
import random_outlines
import rounded_shapes
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
#: rows of the families of meshes and pairs, of each kind
N_ROWS = {"pairs": 40, "meshes": 80, "solids": 30}
#: what is computed with the numbers of each folder; those of the root take part in everything
FAMILIES = {
    "": ("pairs", "meshes", "solids", "loops", "solves"),
    "discrete": ("pairs", "loops", "solves"),
    "estimate": ("loops",),
    "mesh": ("meshes", "solids", "loops"),
    "multigrid": ("solves",),
    "problem": ("pairs", "meshes", "solids"),
    "smoother": ("solves",),
    "solver": ("solves",),
    "transfer": ("pairs", "loops", "solves"),
}


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
    for path in sorted(path for folder in FAMILIES for path in (package / folder).glob("*.py")):
        if path.name in ("__init__.py", "__main__.py", "netgen_worker.py"):
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


def _turned(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Points in a plane at another place, turned and of another size."""
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return 10 ** rng.uniform(-1, 1) * points @ turn + rng.uniform(-1, 1, 2)


def _matched(seed: int) -> tuple:
    """Two blocks, turned: meshes that match in part of the seeds, offset in others."""
    rng = np.random.default_rng((seed, 40))
    left, below = rng.choice([0.0, float(rng.uniform(-0.4, 0.4))]), rng.choice([0.0, 1e-3])
    lower = [(left, -1 - below), (left + 1.5, -1 - below), (left + 1.5, -below), (left, -below)]
    upper = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.7), (0.0, 0.7)]
    corners = _turned(rng, np.array([*upper, *lower]))
    names = ("bottom", "right", "top", "left")
    parts = {
        name: am.Polygon(vertices=corners[k : k + 4], boundaries=names)
        for name, k in (("upper", 0), ("lower", 4))
    }
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        contact=am.ContactPair(
            "upper.bottom", "lower.top", sides=str(rng.choice(["auto", "given"]))
        ),
        material=am.PlaneStrain(young=1e9, poisson=float(rng.choice([0.3, 0.4, 0.45, 0.49]))),
        law=am.Coulomb(0.3) if rng.random() < 0.5 else am.Frictionless(),
        elements=str(rng.choice(["linear", "smoothed"])),
        supports=(
            am.Support("lower.bottom", x=0.0, y=0.0),
            am.Support("upper.left", normal=0.0)
            if rng.random() < 0.5
            else am.Support("upper.top", normal=-1e-3 * float(np.linalg.norm(across))),
        ),
        loads=(am.Pressure("upper.top", 1e6),),
    )
    size = float(np.linalg.norm(along)) / int(rng.integers(4, 9))
    other = size * float(rng.choice([1.0, rng.uniform(0.6, 1.6)]))
    return _discretised(problem, am.mesh.graded(problem.domain, {"upper": size, "lower": other}))


def _spatial(seed: int) -> tuple:
    """Two boxes on each other, turned and shifted in space, with meshes that do not match."""
    rng = np.random.default_rng((seed, 45))
    angle = float(rng.uniform(0, 90))
    axis = tuple(rng.normal(size=3))
    offset = tuple(rng.uniform(-1, 1, 3))
    left, front, below = *rng.uniform(-0.6, 0.0, 2), rng.choice([0.0, 0.02])
    boxes = {
        "upper": am.Box(width=1.0, depth=1.0, height=0.6),
        "lower": am.Box(
            width=1.3, depth=1.1, height=0.6, origin=(left, front, -0.6 - float(below))
        ),
    }
    problem = am.ContactProblem(
        domain=am.Assembly(
            parts={
                name: am.Moved(box, offset, angle=angle, axis=axis) for name, box in boxes.items()
            }
        ),
        contact=am.ContactPair("upper.bottom", "lower.top"),
        material=am.Solid(young=1e9, poisson=0.3),
        law=am.Coulomb(0.3),
        supports=(am.Support("lower.bottom", x=0.0, y=0.0, z=0.0),),
        loads=(am.Pressure("upper.top", 1e6),),
    )
    sizes = {name: float(rng.uniform(0.2, 0.4)) for name in boxes}
    return _discretised(problem, am.mesh.graded(problem.domain, sizes))


def _node_to_node(seed: int) -> tuple:
    """Two blocks with nodes opposite, up to a hundredth of an edge."""
    rng = np.random.default_rng((seed, 46))
    n = int(rng.integers(3, 8))
    left = float(rng.choice([0.0, 10 ** rng.uniform(-6, -1.5)])) / n
    parts = {
        "upper": am.Rectangle(width=1.0, height=0.5, origin=(left, 0.0)),
        "lower": am.Rectangle(width=1.0, height=0.5, origin=(0.0, -0.5)),
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        contact=am.ContactPair("upper.bottom", "lower.top", coupling="nodes"),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=am.Frictionless(),
        supports=(am.Support("lower.bottom", x=0.0, y=0.0),),
        loads=(am.Pressure("upper.top", 1e6),),
    )
    return _discretised(problem, am.mesh.structured(problem.domain, n))


def _conforming(seed: int) -> tuple:
    """A pin in its bush, or a bead or ball in its cup, with coarse rims."""
    rng = np.random.default_rng((seed, 41))
    problem, r, _ = conforming_pairs._posed(rng)
    sizes = {"inner": 0.2 * r, "outer": float(rng.uniform(0.15, 0.3)) * r}
    return _discretised(problem, am.mesh.graded(problem.domain, sizes, ("inner.rim", "outer.hole")))


def _shape(mesh: am.MeshArrays) -> tuple:
    """Counts of a mesh, and its angles, edges and volume."""
    quality = am.mesh.quality(mesh)
    numbers = (quality.min_angle, mesh.element_sizes.max(), mesh.volumes.sum())
    return (mesh.n_nodes, len(mesh.elements), len(mesh.facets)), np.array(numbers)


def _plane(seed: int) -> tuple:
    """A mesh of a random outline, or of a rounded shape."""
    rng = np.random.default_rng((seed, 42))
    if seed % 2:
        outline, _ = random_outlines.random_outline(rng)
    else:
        shape = rounded_shapes.SHAPES[seed // 2 % len(rounded_shapes.SHAPES)](rng, True)
        outline = shape.placed(10 ** rng.uniform(-3, 1) * np.eye(2), rng.uniform(-1, 1, 2))
    extent = float((outline.upper - outline.lower).max())
    name = str(rng.choice(outline.boundaries))
    ratio = float(rng.choice([1.0, 4.0, 16.0]))
    size = extent * 10 ** rng.uniform(-1.2, -0.5)
    mesh = am.mesh.graded(outline, size, [name] if ratio > 1 else [], ratio)
    marked = np.arange(len(mesh.elements)) < len(mesh.elements) // 3
    return _shape(am.mesh.onto_domain(outline, am.mesh.bisect(mesh, marked)[0], mesh.n_nodes))


def _dipped(seed: int) -> tuple:
    """A mesh of a rounded shape that is fine around points inside it."""
    rng = np.random.default_rng((seed, 47))
    shape = rounded_shapes.SHAPES[seed % len(rounded_shapes.SHAPES)](rng, True)
    outline = shape.placed(np.eye(2), rng.uniform(-1, 1, 2))
    extent = float((outline.upper - outline.lower).max())
    places = rng.uniform(outline.lower, outline.upper, (4, 2))
    size = extent * 10 ** rng.uniform(-1.2, -0.6)
    least = size * 10 ** rng.uniform(-1.5, -0.3)

    def sizes(points: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
        return np.minimum(size, least + 0.3 * away)

    return _shape(am.mesh.sized(outline, sizes, size))


def solid(rng: np.random.Generator) -> tuple[am.problem.Domain, str]:
    """A random solid of unit size, and one of its boundaries."""
    a, b, c = (float(x) for x in rng.uniform(0.3, 1.0, 3))
    box = am.Box(width=a, depth=b, height=c)
    hole = am.Cylinder((a / 2, b / 2, -1.0), (0.0, 0.0, 1.0), 0.3 * min(a, b), 3.0)
    profile = am.Polygon(
        vertices=((0.2, 0.0), (0.2 + a, 0.0), (0.2 + b, c), (0.2, c)),
        boundaries=("bottom", "side", "top", "bore"),
    )
    kinds = (
        (box, "bottom"),
        (am.Cylinder((0, 0, 0), tuple(rng.normal(size=3)), a, b), "side"),
        (am.Ball((0.0, a, 0.0), b), "surface"),
        (am.Cut(box, hole), "bottom"),
        (am.Revolution(profile), "side"),
        (am.Extrusion(replace(profile, boundaries=("a", "b", "c", "d")), c), "b"),
        (am.Cut(am.Ball((0.0, 0.0, 0.0), a), am.Box(width=2.0, depth=2.0, height=2.0)), "surface"),
    )
    return kinds[rng.integers(len(kinds))]


def _solid(seed: int) -> tuple:
    """A mesh of a random solid, bisected onto its faces."""
    rng = np.random.default_rng((seed, 43))
    domain, name = solid(rng)
    offset = tuple(rng.uniform(-1, 1, 3))
    domain = am.Moved(domain, offset, angle=90 * rng.uniform(), axis=tuple(rng.normal(size=3)))
    ratio = float(rng.choice([1.0, 3.0]))
    size = float(rng.uniform(0.25, 0.45))
    mesh = am.mesh.graded(domain, size, [name] if ratio > 1 else [], ratio)
    marked = np.arange(len(mesh.elements)) < len(mesh.elements) // 3
    return _shape(am.mesh.onto_domain(domain, am.mesh.bisect(mesh, marked)[0], mesh.n_nodes))


def _settled(row: Callable[[int], tuple], seed: int) -> tuple:
    try:
        return row(seed)
    except ValueError as error:
        return (type(error).__name__, str(error)[:20]), np.zeros(0)


@cache
def battery(family: str) -> dict[str, Callable[[], tuple]]:
    """What is computed with each value of a constant."""
    plain = {
        "pairs": (_matched, _conforming, _spatial, _node_to_node),
        "meshes": (_plane, _dipped),
        "solids": (_solid,),
    }
    if family in plain:
        return {
            f"{row.__name__[1:]} {seed}": lambda row=row, seed=seed: _settled(row, seed)
            for row in plain[family]
            for seed in range(N_ROWS[family])
        }
    if family == "loops":
        return {f"loop {seed}": lambda seed=seed: _loop(seed) for seed in range(300, 320)}
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
    return rows


def computed(families: tuple[str, ...]) -> dict[str, tuple]:
    """Every row of some families."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {name: row() for family in families for name, row in battery(family).items()}


@cache
def before(families: tuple[str, ...]) -> dict[str, tuple]:
    """Return the values that the unchanged package computes."""
    return computed(families)


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
    folder = number.module.split(".")[1]
    families = FAMILIES["" if folder.startswith("_") else folder]
    expected = before(families)
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
        found = computed(families)
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
        sum(
            row[0][1]
            for name, row in rows.items()
            if name.startswith(("nested", "from")) and len(row[0]) == 3
        )
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
