"""Adaptive loops, estimates, goals and true errors that make no sense; user-defined parts that do not fit."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from hostile_table import Hostile

import adaptmg as am
from adaptmg.estimate import Doerfler, Reference, Remesh, Residual, energy_error
from adaptmg.mesh import merged, structured

NAN = float("nan")


def _rows(what: str, run: Callable[[object], object], says: str, values: Mapping[str, object] | tuple,
          error: tuple[type[Exception], ...] = (ValueError, TypeError)) -> Iterator[Hostile]:
    """A row for each value that ``run`` must refuse."""
    for label, value in values.items() if isinstance(values, Mapping) else enumerate(values):
        yield Hostile(f"{what} {label}", lambda v=value: run(v), says, error)


_problem = cache(am.cases.greco_bar)
_grids = cache(lambda: am.Hierarchy.uniform(_problem(), (2, 4)))
_result = cache(lambda: am.solve(_grids()))
_patch = cache(lambda: am.solve(am.Hierarchy.graded(am.cases.two_block_patch(), (0.03,)), am.ActiveSet()))


def _bare():
    d = _grids().finest.discrete
    return am.solve(am.DiscreteProblem(matrix=d.matrix, load=d.load, fixed=d.fixed, law=am.Coulomb(1.0),
                                       contact=d.contact), am.ActiveSet())


def _mesh():
    return _grids().finest.mesh


def _loop(start=20e-3, **options):
    return list(am.adapt(_problem(), start, **({"engine": am.Bisect(), "max_nodes": 60} | options)))


def _refining(answer, **methods):
    """An engine that makes what a function of the mesh says."""
    return SimpleNamespace(refine=lambda problem, mesh, estimate, marked, max_nodes=None: answer(mesh), **methods)


def _finer(mesh):
    return am.mesh.bisect(mesh, np.ones(len(mesh.elements), dtype=bool))[0]


def _changed(mesh, **changes):
    return replace(mesh, source=None, **changes)


def _moved(mesh, value):
    points = _finer(mesh).points.copy()
    points[-1] = value
    return _changed(_finer(mesh), points=points)


#: what is not a finer mesh of the problem
MESHES = {
    "text": lambda m: "mesh", "arrays": lambda m: (_finer(m).points, _finer(m).elements),
    "folded": lambda m: _moved(m, 5.0),
    "with a hole": lambda m: _changed(_finer(m), elements=_finer(m).elements[:-1], element_body=None),
    "without names": lambda m: _changed(_finer(m), boundaries=tuple("abcd")),
    "other bodies": lambda m: merged({"a": _finer(m), "b": _changed(m, points=m.points + 1.0)}),
    "3D": lambda m: structured(am.cases.greco_block().domain, 3),
}
FEW = {label: MESHES[label] for label in ("folded", "without names")}
#: sound ones that lie elsewhere, which the transfer refuses
ELSEWHERE = {"elsewhere": lambda m: _changed(_finer(m), points=_finer(m).points + 1.0),
             "ten times as large": lambda m: _changed(_finer(m), points=_finer(m).points * 10.0)}


def _parts():
    n = len(_mesh().elements)
    answers = {"None": None, "array": np.ones(n), "class": am.Estimate,
               "of another mesh": am.Estimate(squares=np.ones(3), norm=1.0)}
    path = {"load_path": am.LoadPath(default=[0.5, 1.0]), "adapt_on": "worst"}
    for where, options in (("", {}), (" on a path", path)):
        yield from _rows(f"indicator{where} returns", lambda v, o=options: _loop(
            indicator=SimpleNamespace(indicate=lambda hierarchy, result: v), **o), "indicator", answers)
    masks = {"None": lambda e: None, "short": lambda e: np.ones(3, dtype=bool), "indices": lambda e: np.array([0, 1]),
             "text": lambda e: "all", "flag": lambda e: True, "NaN": lambda e: np.full(len(e.squares), NAN),
             "matrix": lambda e: np.ones((len(e.squares), 2), dtype=bool), "list": lambda e: ["a"] * len(e.squares)}
    yield from _rows("mark returns", lambda v: _loop(mark=SimpleNamespace(mark=v)), "mark", masks)
    yield from _rows("engine returns", lambda v: _loop(engine=_refining(v)), "engine", MESHES)
    yield from _rows("engine returns a mesh", lambda v: _loop(engine=_refining(v)), "mesh", ELSEWHERE)
    yield from _rows("intermediate returns", lambda v: _loop(max_nodes=2000, engine=_refining(
        lambda mesh: _finer(_finer(_finer(mesh))), intermediate=lambda p, coarse, fine: v(fine))), "engine", FEW)
    yield from _rows("first returns", lambda v: _loop(engine=_refining(
        v, first=lambda problem, size: v(_mesh()))), "engine", FEW)


def _refined(engine, **wrong):
    n = len(_mesh().elements)
    given = {"problem": _problem(), "mesh": _mesh(), "estimate": am.Estimate(squares=np.ones(n), norm=1.0),
             "marked": np.ones(n, dtype=bool)}
    return engine.refine(**(given | wrong))


def _marking():
    yield from _rows("Doerfler marks", Doerfler().mark, "estimate", ([1.0, NAN], [1.0, -1.0], [], np.eye(2), [1j]))
    for engine in (am.Bisect(), Remesh()):
        yield Hostile(f"{type(engine).__name__} of another estimate", lambda e=engine: _refined(
            e, estimate=am.Estimate(squares=[1.0], norm=1.0)), "estimate is of")
    yield Hostile("Bisect marks numbers", lambda: _refined(am.Bisect(), marked=np.arange(9)), "boolean mask")


def _goals():
    yield from _rows("goal of", am.Goal, "quantity", ("u", am.ContactForce, [], [am.ContactForce(), "u"]))
    yield from _rows("points", lambda v: am.Displacement(v, "x"), "points", (
        (0.0, NAN), (1.0,), (0.0,) * 4, (), [(0.0, 0.0), (0.0,)], (0.0, 1j), (True, False)))
    yield from _rows("component", lambda v: am.Displacement((0.0, 0.0), v), "component", ("w", 3, -1, True, 0.5))
    yield from _rows("opening at", lambda v: am.Opening("bottom", v), "point", ((0.0, NAN), (), np.eye(2)))
    wrong = {"points": (am.Displacement((1.0, 1.0), "x"), am.Displacement((0.0, 0.0, 0.0), "x")),
             "component": (am.Displacement((0.0, 0.0), "z"), am.MeanDisplacement("top", 2)),
             "body": (am.Displacement((0.0, 0.0), "x", body="upper"),),
             "nowhere": (am.MeanDisplacement("nowhere", "x"), am.ContactForce("nowhere"), am.Opening("nowhere")),
             "top": (am.ContactForce("top"), am.Opening("top")), "direction": (am.ContactForce("bottom", "z"),),
             "point": (am.Opening("bottom", (1.0, 0.0)), am.Opening("bottom", (0.0, 0.0, 0.0)),
                       am.Opening("bottom", (0.01, 0.03)))}
    for says, quantities in wrong.items():
        yield from _rows(f"goal {says}", lambda v: am.Goal(v).indicate(_grids(), _result()), says, quantities)
    yield from _rows("own quantity", lambda v: am.Goal(SimpleNamespace(functionals=lambda view: v)).indicate(
        _grids(), _result()), "quantity", (None, "u", [], [1.0], np.ones(3)))

    def of(changes):
        def made(view):
            good = am.ContactForce().functionals(view)[0]
            return [replace(good, **{name: change(getattr(good, name)) for name, change in changes.items()})]
        return am.Goal(SimpleNamespace(functionals=made)).indicate(_grids(), _result())

    for name, change in {"vector": (lambda a: a[:-1], lambda a: a * NAN, lambda a: "v", lambda a: a[:, None]),
                         "bubbles": (lambda a: None, lambda a: a[1:], lambda a: a * NAN),
                         "value": (lambda a: NAN, lambda a: "1")}.items():
        yield from _rows(f"own functional {name}", lambda v, n=name: of({n: v}), name, change)


def _errors():
    wrong = {
        "result is of another mesh": lambda i: i.indicate(am.Hierarchy.uniform(_problem(), (2, 6)), _result()),
        "loads": lambda i: i.indicate(_grids(), am.solve(
            am.Hierarchy.uniform(am.cases.greco_bar(top_pressure=1e7), (2, 4)))),
        "result has no mesh": lambda i: i.indicate(_grids(), _bare()),
        "displacement": lambda i: i.indicate(_grids(), replace(_result(), displacement=_result().displacement * NAN))}
    for says, run in wrong.items():
        for indicator in (Residual(), am.Goal(am.ContactForce())):
            yield Hostile(f"{type(indicator).__name__}: {says}", lambda i=indicator, r=run: r(i), says)
    yield from _rows("reference", lambda v: energy_error(v, _result()), "reference", (
        (1,), "reference", (1, 2, 3)))
    yield Hostile("reference of texts", lambda: energy_error(("r", "h"), _result()), "hierarchy")
    results = {"text": lambda: "r", "bare": _bare}
    yield from _rows("error of", lambda v: energy_error((_grids(), _result()), v()), "result",
                     results | {"pair": _patch})
    yield from _rows("own_error", lambda v: Reference.of(_grids(), _result(), own_error=v), "own_error", (-1.0, True))


def _levels():
    says = {"without names": "bound", "folded": "degenerate"}
    for label, made in FEW.items():
        yield Hostile(f"append {label}", lambda m=made: _grids().append(m(_mesh())), says.get(label, "mesh"),
                      (TypeError, ValueError, FileNotFoundError))
    yield from _rows("append", lambda v: _grids().append(v and _grids()[0].mesh), "mesh", {"coarser": 1, "None": None})
    yield from _rows("without", lambda v: _grids().without(v), "level", (-3, 2))
    yield Hostile("without the only one", lambda: am.Hierarchy.uniform(_problem(), (2,)).without(0), "level")


INPUTS = (*_parts(), *_marking(), *_goals(), *_errors(), *_levels())
