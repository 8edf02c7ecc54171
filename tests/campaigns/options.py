"""Call every public function, class and method with wrong values, one argument at a time, and list
what is let through silently, and what fails from inside with an error that does not name the
argument.

Run ``python tests/campaigns/options.py``. A seed is the number of a door. The table of rows has for
each door the calls, those refused with the name of the argument, and faults. ``FREE`` has the
arguments that may be any text; values that suit the annotation of an argument are not wrong."""

from __future__ import annotations

import inspect
import os
import re
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from pathlib import Path

import campaign
import matplotlib

matplotlib.use("Agg")
import numpy as np
import pandas as pd
from scipy import sparse

import adaptmg as am

MODULES = [
    am,
    am.cases,
    am.discrete,
    am.estimate,
    am.export,
    am.mesh,
    am.multigrid,
    am.plot,
    am.problem,
    am.smoother,
    am.solver,
    am.study,
    am.transfer,
]
ANY = object()
#: wrong values, and words in an annotation which says that such a value is right
VALUES: dict[str, tuple[object, str]] = {
    "None": (None, "None"),
    "True": (True, "bool|Flag"),
    "3": (3, "float|int|Size|Quantity|Value|Stiffness|FieldLike"),
    "-1": (-1, "float|int|Quantity|Value|FieldLike"),
    "2.5": (2.5, "float|Size|Quantity|Value|Stiffness|FieldLike"),
    "nan": (float("nan"), ""),
    "'nobody'": ("nobody", "Name"),
    "b'x'": (b"x", ""),
    "1j": (1j, ""),
    "an object": (ANY, ""),
    "[]": ([], "Sequence|tuple|list|Iterable|Contact|Load|Support"),
    "{}": ({}, "Mapping|dict"),
    "[an object]": ([ANY], ""),
    "{'nobody': an object}": ({"nobody": ANY}, ""),
    "a class": (dict, ""),
    "array of nan": (np.full(3, np.nan), ""),
}
#: arguments that are any text, or whose values have any type
FREE = re.compile(
    "name|caption|note|title|summary|terms|text|description|csv|indicator|words|body|boundary|"
    "against|key|to|unnamed|store|path|folder|directory|callback"
)
#: arguments that are optional, but one of them is needed
NEEDED: dict[str, dict[str, object]] = {
    "Support": {"x": 0.0},
    "PointSupport": {"x": 0.0},
    "PointSpring": {"x": 1.0},
    "Spring": {"normal": 1.0},
    "Hierarchy.algebraic": {"max_coarse": 9},
}
#: classes that the package makes, protocols, and what waits for hours or for the world
LEFT_OUT = re.compile(
    "Law|Smoother|Transfer|Domain|LocalProblem|LocalSystem|NodalContact|Supports|Location|State|"
    "Reference|EnergyError|Result|PathResult|Step|Level|StudyStatus|MeshQuality|Certificate|"
    "NotConverged|Case|GoalEstimate|set_threads|local_cluster|StepFile|step_table|touching|"
    "step_problem|local_prolongations|TransitionField|Hierarchy|DiscreteProblem|.*_gap|.*_slip|"
    "need_.*|at_nodes|bounds|alike|relative|of|resolved"
)


@cache
def made() -> dict[str, object]:
    """Right arguments by their names."""
    bar = am.cases.greco_bar()
    grids = am.Hierarchy.uniform(bar, divisions=(2, 4))
    result = am.solve(grids)
    square = am.Rectangle(width=1, height=1)
    ball = am.Ball((0.0, 0.0, 0.0), 1.0)
    step = next(iter(am.adapt(bar, 20e-3, max_nodes=20, engine=am.Bisect())))
    mesh, discrete = grids.finest.mesh, grids.finest.discrete
    folder = Path(tempfile.mkdtemp())
    saved = folder / "saved.npz"
    result.save(saved)
    am.export.mesh(mesh, folder / "a.msh")
    scalars = {
        "width depth height radius size base h at limit start max_size load modulus half_width": 1.0,
        "young": 1e9,
        "poisson friction grading theta": 0.3,
        "tangential": 0.1,
        "force": (None, 1.0),
        "pre post divisions levels threads workers count runs n_old": 2,
        "body boundary contact_boundaries slave": "a",
        "master": "b",
        "name": "greco_bar",
        "component direction": "x",
        "axis": "y",
        "components normal displacement": (0.0, 1.0),
        "point about origin": (0.0, 0.0),
        "points": ((0.01, 0.01),),
        "vertices": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)),
        "boundaries": tuple("abcd"),
        "facets": mesh.facets[:1],
        "parts": {"a": square},
        "cracks": {"c": ((0.2, 0.5), (0.8, 0.5))},
        "function size_function": lambda x: 0.5 + 0 * x[:, 0],
        "obstacle": am.Plane((0.0, 0.0), (0.0, 1.0)),
        "solid a b": ball,
        "centre": (0.0, 0.0),
        "law": am.Coulomb(0.3),
        "material": am.PlaneStrain(young=1e9, poisson=0.3),
        "quantity": am.ContactForce(),
        "problem posed": bar,
        "mesh drawn coarse fine": mesh,
        "grids hierarchy": grids,
        "discrete": discrete,
        "matrix": discrete.matrix,
        "fixed": discrete.fixed,
        "result results": result,
        "steps": [step],
        "estimate": step.estimate,
        "marked": np.ones(len(mesh.elements), bool),
        "path": folder / "a.vtu",
        "meshes": [mesh],
        "sizes": [0.02, 0.01],
        "supports": (am.Support("right", x=0.0),),
        "loads": (am.Pressure("top", 1.0),),
        "squares": (1.0,),
        "norm": 1.0,
        "parameters": {"n": [1]},
        "ranges": {"n": (0.0, 1.0)},
        "run": _square,
        "table": pd.DataFrame({"n": [1.0, 2.0], "m": [2.0, 3.0]}),
        "stress": np.ones((4, 4)),
        "nodal P P_cc": sparse.csr_array(np.eye(len(mesh.points))),
        "domain polygon": square,
    }  # fmt: skip
    return {name: value for names, value in scalars.items() for name in names.split()} | {
        "element_strain.displacement full_stress.displacement": result.displacement,
        "graded.contact_boundaries refine_near.boundaries check_mesh.boundaries": "top",
        "merged.meshes": {"a": mesh},
        "graded.domain sized.domain structured.domain onto_domain.domain": square,
        "Ball.centre": (0.0, 0.0, 0.0),
        "Cylinder.point": (0.0, 0.0, 0.0),
        "Cylinder.axis": (0.0, 0.0, 1.0),
        "solve_path.path": am.LoadPath(),
        "study_report.parameters": ["n"],
        "study_report.path": folder / "a.html",
        "mesh.path": folder / "b.msh",
        "from_file.path as_mesh.mesh": folder / "a.msh",
        "PartialSlip.normal": am.cases.HertzContact(load=1.0, radius=1.0, modulus=1.0),
        "Points.points": [{"n": 1}],
        "plot.path.result": am.solve_path(grids, am.LoadPath({"top": [0.5, 1.0]})),
        "PlaneStrain.poisson": 0.3,
        "energy_error.reference": (grids, result),
        "Hierarchy.levels": grids.levels,
        "adapt.start": 20e-3,
        "Moving.displacement": (0.0, 0.1),
        "Preload.force": 1.0,
        "MeanDisplacement.boundary Displacement.boundary": "top",
        "Displacement.points": (0.0, 0.0),
        "with_problem.problem": bar,
        "indicate.result": result,
        "resultant.boundary reaction.boundary": "contact",
        "vtk_series.results load_history.results": [result],
        "history.results": result,
        "local_system.problem": discrete,
        "mesh_ratio.coarse size_ratio.coarse": grids.coarsest.mesh
        if hasattr(grids, "coarsest")
        else mesh,
        "append.mesh": am.mesh.structured(bar.domain, 8),
        "level": 0,
        "Pressure.value": 1.0,
        "Support.boundary Spring.boundary": "right",
        "von_mises.stress": np.ones((4, 3, 3)),
        "title": "a",
        "vtk_series.path": folder / "a.pvd",
        "what": "a",
        "Hierarchy.algebraic.max_coarse": 9,
        "without_fixed.fixed": np.zeros(50, bool),
        "boundary_facets.boundary boundary_nodes.boundary surface.boundary": "top",
        "Result.load.path": saved,
        "folder": folder / "path",
        "PathResult.count.value PathResult.index.value": 1.0,
        "work_to.error": 0.1,
        "n_contact": 2,
        "distance": 0.1,
        "factor": 2.0,
        "rtol": 0.1,
        "Level.inject.u Level.restrict.r": np.zeros((len(mesh.points), 2)),
        "sets": am.transfer.supports(sparse.csr_array(np.eye(4))),
        "opening limit": np.ones(4),
        "slip": np.ones((4, 1)),
        "weights": np.ones(2),
        "shear": (1e9, 1e9, 1e9),
        "text": "a",
        "refine.estimate refine.field": am.Estimate(squares=np.ones(len(mesh.elements)), norm=1.0),
        "row": 0,
        "prolong.u inject.u": np.zeros((len(grids.levels[0].mesh.points), 2)),
        "max_nodes": 100,
        "max_coarse": 50,
        "prolongations": [sparse.csr_array(np.eye(2 * len(mesh.points)))],
        "load_history.factors": [1.0],
        "load_history.quantities": {"force": lambda r: 1.0},
    }


def _square(n):
    return {"m": n * n}


def samples() -> dict[str, object]:
    """Objects whose methods are doors."""
    pool = made()
    study = am.Study(_square, {"n": [1, 2]})
    study.run(progress=False)
    return {
        "Hierarchy": pool["grids"],
        "Level": pool["grids"].finest,
        "Result": pool["result"],
        "PathResult": pool["plot.path.result"],
        "Step": pool["steps"][0],
        "Estimate": pool["estimate"],
        "MeshArrays": pool["mesh"],
        "DiscreteProblem": pool["discrete"],
        "ContactProblem": pool["problem"],
        "Study": study,
        "Rectangle": pool["domain"],
        "Ball": pool["a"],
        "Plane": pool["obstacle"],
        "PlaneStrain": pool["material"],
        "Doerfler": am.Doerfler(),
        "Maximum": am.Maximum(),
        "Residual": am.Residual(),
        "Recovery": am.Recovery(),
        "Goal": am.Goal(am.ContactForce()),
        "SizeNear": am.SizeNear([[0.0, 0.0]], size=0.1),
        "HertzContact": pool["PartialSlip.normal"],
        "Report": am.export.Report("a"),
        "Interpolation": am.Interpolation(),
        "PseudoL2": am.PseudoL2(),
        "Certificate": pool["result"].certificate(),
        "PointLocator": am.transfer.PointLocator(pool["mesh"]),
    }


@cache
def doors() -> list[tuple[str, Callable[..., object]]]:
    """Public callables by their names."""
    found: dict[int, tuple[str, Callable[..., object]]] = {}
    for module in MODULES:
        for name in dir(module):
            value = getattr(module, name)
            own = str(getattr(value, "__module__", "")).startswith("adaptmg")
            is_error = isinstance(value, type) and issubclass(value, Exception | Enum)
            if callable(value) and own and not LEFT_OUT.fullmatch(name) and not is_error:
                found.setdefault(
                    id(value),
                    (
                        f"{module.__name__.removeprefix('adaptmg').lstrip('.')}.{name}".lstrip("."),
                        value,
                    ),
                )
    result = list(found.values())
    for kind, one in samples().items():
        for name in dir(type(one)):
            hidden = name.startswith("_") or LEFT_OUT.fullmatch(name)
            value = None if hidden else inspect.getattr_static(type(one), name)
            if inspect.isfunction(value) or isinstance(value, classmethod | staticmethod):
                result.append((f"{kind}.{name}", getattr(one, name)))
    return result


def right(door: str, name: str) -> object:
    """Return a right value of an argument of a door; KeyError if there is none."""
    last = door.split(".")[-1]
    for keys, value in made().items():
        if {f"{door}.{name}", f"{last}.{name}"} & set(keys.split()) and "." in keys:
            return value
    return made()[name]


def wrong(argument: inspect.Parameter) -> Iterator[tuple[str, object]]:
    """Yield the values that do not suit the annotation of an argument."""
    hint = str(argument.annotation)
    for label, (value, words) in VALUES.items():
        suits = words and re.search(rf"\b\w*({words})\w*\b", hint)
        if value is None and argument.default is None:
            continue
        if suits or (label == "'nobody'" and FREE.fullmatch(argument.name)):
            continue
        if (label == "an object" and re.search(r"\bobject\b|\bAny\b", hint)) or (
            label == "a class" and "Callable" in hint
        ):
            continue
        yield label, value


class Late(Exception):
    """A call that does not end."""


def _late(*_: object) -> None:
    raise Late("20 s")


def outcome(door: Callable[..., object], given: dict[str, object], name: str) -> str:
    """Return "" for a refusal that names the argument, else what happened."""
    signal.signal(signal.SIGALRM, _late)
    signal.alarm(20)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = door(**given)
            if inspect.isgenerator(result):
                next(result)
    except (TypeError, ValueError, OSError) as error:
        text = f"{error} {' '.join(getattr(error, '__notes__', ()))}"
        stem = name.rstrip("s").replace("_", "[_ ]")
        return (
            ""
            if re.search(rf"\b{stem}", text, re.I)
            else f"inside: {type(error).__name__}: {text[:110]}"
        )
    except Exception as error:
        return f"inside: {type(error).__name__}: {str(error)[:110]}"
    finally:
        signal.alarm(0)
    return "let through"


def measure(seed: int) -> dict[str, object]:
    """Call one door with all wrong values."""
    name, door = doors()[seed]
    row: dict[str, object] = {"door": name, "calls": 0, "refused": 0, "faults": "", "why": ""}
    sys.stderr.write(f"  {name}\n")
    os.chdir(tempfile.mkdtemp())
    taken = {
        key: one
        for key, one in inspect.signature(door).parameters.items()
        if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL) and key != "self"
    }
    try:
        needed = {key: right(name, key) for key, one in taken.items() if one.default is one.empty}
        needed |= NEEDED.get(name, {})
    except KeyError as error:
        return row | {"why": f"no right value of {error}"}
    if (fault := outcome(door, needed, "no such name")) != "let through":
        return row | {"why": f"right values are refused: {fault or 'named'}"}
    faults: dict[str, list[str]] = {}
    for key, argument in taken.items():
        if argument.kind is argument.POSITIONAL_ONLY:
            continue
        for label, value in wrong(argument):
            said = outcome(door, needed | {key: value}, key)
            row["calls"] += 1
            row["refused"] += not said
            if said:
                faults.setdefault(f"{key}: {said}", []).append(label)
    return row | {
        "faults": "; ".join(f"{said} ({', '.join(labels)})" for said, labels in faults.items())
    }


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return the doors that have faults, or were not tried."""
    return table[(table["faults"] != "") | (table["why"] != "")][
        ["door", "calls", "refused", "why"]
    ]


if __name__ == "__main__":
    campaign.main(measure, summary, range(len(doors())))
