"""Adaptive loops, estimates, goals and true errors that make no sense; user-defined parts that do
not fit."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from hostile_table import Hostile, each, labelled

import adaptmg as am

NAN = float("nan")
_problem = cache(am.cases.greco_bar)
_grids = cache(lambda: am.Hierarchy.uniform(_problem(), (2, 4)))
_result = cache(lambda: am.solve(_grids()))


def _bare():
    d = _grids().finest.discrete
    return am.solve(
        am.DiscreteProblem(
            matrix=d.matrix, load=d.load, fixed=d.fixed, law=am.Coulomb(1.0), contact=d.contact
        ),
        am.ActiveSet(),
    )


def _mesh():
    return _grids().finest.mesh


def _loop(start=20e-3, **options):
    return list(am.adapt(_problem(), start, **({"engine": am.Bisect(), "max_nodes": 60} | options)))


def _refining(answer, **methods):
    """An engine that makes what a function of the mesh says."""
    return SimpleNamespace(
        refine=lambda problem, mesh, estimate, marked, max_nodes=None: answer(mesh), **methods
    )


def _finer(mesh):
    return am.mesh.bisect(mesh, np.ones(len(mesh.elements), dtype=bool))[0]


def _changed(mesh, **changes):
    return replace(mesh, **changes)


def _moved(mesh, value):
    points = _finer(mesh).points.copy()
    points[-1] = value
    return _changed(_finer(mesh), points=points)


#: what is not a finer mesh of the problem
MESHES = {
    "text": lambda m: "mesh",
    "folded": lambda m: _moved(m, 5.0),
    "with a hole": lambda m: _changed(
        _finer(m), elements=_finer(m).elements[:-1], element_body=None
    ),
    "without names": lambda m: _changed(_finer(m), boundaries=tuple("abcd")),
    "other bodies": lambda m: am.mesh.merged(
        {"a": _finer(m), "b": _changed(m, points=m.points + 1.0)}
    ),
    "3D": lambda m: am.mesh.structured(am.cases.greco_block().domain, 3),
}
FEW = ("folded", "without names")
#: a sound one that lies elsewhere, which the transfer refuses
ELSEWHERE = {"elsewhere": lambda m: _changed(_finer(m), points=_finer(m).points + 1.0)}


def _parts():
    answers = labelled(
        (
            None,
            np.ones(len(_mesh().elements)),
            am.Estimate,
            am.Estimate(squares=np.ones(3), norm=1.0),
        )
    )
    path = {"load_path": am.LoadPath(default=[0.5, 1.0]), "adapt_on": "worst"}
    for where, options, labels in (
        ("indicator", {}, ()),
        ("on a path: indicator", path, list(answers)[:1]),
    ):
        yield from each(
            where,
            lambda v, o=options: _loop(
                indicator=SimpleNamespace(indicate=lambda hierarchy, result: v), **o
            ),
            answers,
            labels,
        )
    masks = labelled(
        (lambda e: np.ones(3, dtype=bool), lambda e: np.array([0, 1]), lambda e: "all")
    )
    yield from each("mark", lambda v: _loop(mark=SimpleNamespace(mark=v)), masks)
    yield from each("engine", lambda v: _loop(engine=_refining(v)), MESHES)
    yield from each("engine elsewhere: mesh", lambda v: _loop(engine=_refining(v)), ELSEWHERE)
    yield from each(
        "intermediate of an engine",
        lambda v: _loop(
            max_nodes=2000,
            engine=_refining(
                lambda mesh: _finer(_finer(_finer(mesh))),
                intermediate=lambda p, coarse, fine: v(fine),
            ),
        ),
        MESHES,
        FEW,
    )
    yield from each(
        "first of an engine",
        lambda v: _loop(engine=_refining(v, first=lambda problem, size: v(_mesh()))),
        MESHES,
        FEW,
    )
    yield from each("append degenerate", lambda v: _grids().append(v(_mesh())), MESHES, ("folded",))
    yield Hostile(
        "without the only one", lambda: am.Hierarchy.uniform(_problem(), (2,)).without(0), "level"
    )


def _refined(engine, **wrong):
    n = len(_mesh().elements)
    given = {
        "problem": _problem(),
        "mesh": _mesh(),
        "estimate": am.Estimate(squares=np.ones(n), norm=1.0),
        "marked": np.ones(n, dtype=bool),
    }
    return engine.refine(**(given | wrong))


def _marking():
    for engine in (am.Bisect(), am.Remesh()):
        yield Hostile(
            f"{type(engine).__name__} of another estimate",
            lambda e=engine: _refined(e, estimate=am.Estimate(squares=[1.0], norm=1.0)),
            "estimate is of",
        )
    yield Hostile(
        "Bisect marks numbers", lambda: _refined(am.Bisect(), marked=np.arange(9)), "boolean mask"
    )


def _goals():
    yield from each("goal of quantity", am.Goal, labelled(([], [am.ContactForce(), "u"])))
    yield from each(
        "points",
        lambda v: am.Displacement(v, "x"),
        labelled(((0.0, NAN), (), [(0.0, 0.0), (0.0,)])),
    )
    yield from each("component", lambda v: am.Displacement((0.0, 0.0), v), labelled(("w", 3, True)))
    wrong = {
        "points": (am.Displacement((1.0, 1.0), "x"), am.Displacement((0.0, 0.0, 0.0), "x")),
        "component": (am.Displacement((0.0, 0.0), "z"),),
        "top": (am.ContactForce("top"), am.Opening("top")),
        "body": (am.Displacement((0.0, 0.0), "x", body="upper"),),
        "nowhere": (am.MeanDisplacement("nowhere", "x"),),
        "point": (am.Opening("bottom", (1.0, 0.0)), am.Opening("bottom", (0.0, 0.0, 0.0))),
    }
    for says, quantities in wrong.items():
        yield from each(
            f"goal: {says}",
            lambda v: am.Goal(v).indicate(_grids(), _result()),
            labelled(quantities),
        )
    yield from each(
        "own quantity",
        lambda v: am.Goal(SimpleNamespace(functionals=lambda view: v)).indicate(
            _grids(), _result()
        ),
        labelled((None, [], [1.0])),
    )

    def of(changes):
        def made(view):
            good = am.ContactForce().functionals(view)[0]
            return [
                replace(
                    good, **{name: change(getattr(good, name)) for name, change in changes.items()}
                )
            ]

        return am.Goal(SimpleNamespace(functionals=made)).indicate(_grids(), _result())

    for name, change in {
        "vector": (lambda a: a[:-1], lambda a: a * NAN, lambda a: "v"),
        "value": (lambda a: NAN,),
    }.items():
        yield from each(f"own functional: {name}", lambda v, n=name: of({n: v}), labelled(change))


def _errors():
    wrong = {
        "result is of another mesh": lambda i: i.indicate(
            am.Hierarchy.uniform(_problem(), (2, 6)), _result()
        ),
        "loads": lambda i: i.indicate(
            _grids(), am.solve(am.Hierarchy.uniform(am.cases.greco_bar(top_pressure=1e7), (2, 4)))
        ),
        "result has no mesh": lambda i: i.indicate(_grids(), _bare()),
        "displacement": lambda i: i.indicate(
            _grids(), replace(_result(), displacement=_result().displacement * NAN)
        ),
    }
    for says, run in wrong.items():
        yield Hostile(f"Goal: {says}", lambda r=run: r(am.Goal(am.ContactForce())), says)
    yield from each(
        "reference", lambda v: am.estimate.energy_error(v, _result()), labelled(((1,), "reference"))
    )
    yield Hostile(
        "reference of texts", lambda: am.estimate.energy_error(("r", "h"), _result()), "hierarchy"
    )
    yield from each(
        "error of result",
        lambda v: am.estimate.energy_error((_grids(), _result()), v()),
        {
            "text": lambda: "r",
            "bare": _bare,
            "pair": lambda: am.solve(
                am.Hierarchy.graded(am.cases.two_block_patch(), (0.03,)), am.ActiveSet()
            ),
        },
    )


INPUTS = (*_parts(), *_marking(), *_goals(), *_errors())
