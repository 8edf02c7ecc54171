"""Adaptive loops, estimates, goals and true errors that cannot be what was meant; parts that do not keep their word."""

from dataclasses import replace
from functools import cache

import numpy as np
from hostile_table import Hostile

import adaptmg as am
from adaptmg.estimate import Doerfler, Maximum, Recovery, Reference, Remesh, Residual, boundary_tractions, energy_error
from adaptmg.mesh import MeshArrays, merged, structured

NAN = float("nan")


@cache
def _problem():
    return am.cases.greco_bar()


@cache
def _grids():
    return am.Hierarchy.uniform(_problem(), (2, 4))


@cache
def _result():
    return am.solve(_grids())


def _mesh():
    return _grids().finest.mesh


def _estimate():
    return am.Estimate(squares=np.ones(len(_mesh().elements)), norm=1.0)


def _loop(start=20e-3, **options):
    options = {"engine": am.Bisect(), "max_nodes": 60} | options
    return list(am.adapt(_problem(), start, **options))


def _arguments():
    def values(**rows):
        return rows.items()

    yield Hostile("problem None", lambda: am.adapt(None, max_nodes=9), "problem")
    yield Hostile("problem class", lambda: am.adapt(am.ContactProblem, max_nodes=9), "problem")
    for label, value in values(nan=NAN, zero=0.0, infinite=np.inf, text="5 mm", flag=True, listed=[5e-3],
                               complex=1j, tiny=1e-9, array=np.ones(2), matrix=np.eye(3), mesh_class=MeshArrays,
                               hierarchy_class=am.Hierarchy, result=lambda: 3):
        yield Hostile(f"start {label}", lambda v=value: _loop(v), "start", (TypeError, ValueError, FileNotFoundError))
    for label, value in values(zero=0.0, negative=-1.0, nan=NAN, infinite=np.inf, flag=True, text="1e-2", one=1.0):
        yield Hostile(f"tolerance {label}", lambda v=value: _loop(tolerance=v), "tolerance")
    for label, value in values(zero=0, negative=-3, nan=NAN, half=1.5, flag=True, text="100", infinite=np.inf):
        yield Hostile(f"max_nodes {label}", lambda v=value: _loop(max_nodes=v), "max_nodes")
    for label, value in values(zero=0, negative=-3.0, nan=NAN, flag=True, text="100", infinite=np.inf):
        yield Hostile(f"max_seconds {label}", lambda v=value: _loop(max_seconds=v), "max_seconds")
    parts = {"indicator": (Residual, am.Goal, "residual", 3, Doerfler()), "mark": (Doerfler, Maximum, 0.5, Residual()),
             "engine": (Remesh, am.Bisect, "bisect", 2.5, Residual()),
             "solver": (am.FullMultigrid, "multigrid", am.AMG()), "transfer": (am.L2, "L2", 3),
             "load_path": (am.LoadPath, [0.5, 1.0], 1.0), "adapt_on": ("first", 0, None, True),
             "progress": (True, "bar", 3), "store": (3, True, "", b"\0", ["a"])}
    for name, given in parts.items():
        for k, value in enumerate(given):
            yield Hostile(f"{name} {k}", lambda n=name, v=value: _loop(**{n: v}), name)


class _Part:
    """An indicator, mark or engine that answers what it is told to."""

    def __init__(self, answer):
        self.answer = answer

    def indicate(self, hierarchy, result):
        return self.answer(hierarchy, result)

    def mark(self, estimate):
        return self.answer(estimate)

    def refine(self, problem, mesh, estimate, marked, max_nodes=None):
        return self.answer(mesh)


class _Between(_Part):
    """Bisection of everything; in between what it is told to."""

    def refine(self, problem, mesh, estimate, marked, max_nodes=None):
        for _ in range(3):
            mesh = am.mesh.bisect(mesh, np.ones(len(mesh.elements), dtype=bool))[0]
        return mesh

    def intermediate(self, problem, coarse, fine):
        return self.answer(fine)


class _First(_Part):
    """Begins with what it is told to."""

    def first(self, problem, size):
        return self.answer(size)


def _spoilt(mesh, **changes):
    return replace(mesh, source=None, **changes)


def _meshes():
    """What is no finer mesh of the problem, by label."""
    def finer(mesh):
        return am.mesh.bisect(mesh, np.ones(len(mesh.elements), dtype=bool))[0]

    def moved(mesh, value):
        points = finer(mesh).points.copy()
        points[-1] = value
        return _spoilt(finer(mesh), points=points)

    return {
        "text": lambda m: "mesh", "arrays": lambda m: (finer(m).points, finer(m).elements),
        "class": lambda m: MeshArrays,
        "number": lambda m: 3, "hierarchy": lambda m: _grids(), "NaN": lambda m: moved(m, NAN),
        "folded": lambda m: moved(m, 5.0), "with a hole": lambda m: _spoilt(
            finer(m), elements=finer(m).elements[:-1], element_body=None),
        "without names": lambda m: _spoilt(finer(m), boundaries=tuple("abcd")),
        "other bodies": lambda m: merged({"a": finer(m), "b": _spoilt(m, points=m.points + 1.0)}),
        "3D": lambda m: structured(am.cases.greco_block().domain, 3),
        "elsewhere": lambda m: _spoilt(finer(m), points=finer(m).points + 1.0),
        "ten times as large": lambda m: _spoilt(finer(m), points=finer(m).points * 10.0),
    }


def _parts():
    n = len(_mesh().elements)
    answers = {"None": None, "array": np.ones(n), "text": "good", "class": am.Estimate, "number": 3.0,
               "of another mesh": am.Estimate(squares=np.ones(3), norm=1.0)}
    for label, value in answers.items():
        yield Hostile(f"indicator returns {label}", lambda v=value: _loop(indicator=_Part(lambda h, r: v)),
                      "indicator")
        yield Hostile(f"indicator on a path returns {label}", lambda v=value: _loop(
            indicator=_Part(lambda h, r: v), load_path=am.LoadPath(default=[0.5, 1.0]), adapt_on="worst"), "indicator")
    masks = {"None": lambda e: None, "short": lambda e: np.ones(3, dtype=bool), "indices": lambda e: np.array([0, 1]),
             "numbers": lambda e: e.squares, "text": lambda e: "all", "flag": lambda e: True,
             "NaN": lambda e: np.full(len(e.squares), NAN),
             "matrix": lambda e: np.ones((len(e.squares), 2), dtype=bool),
             "list": lambda e: ["a"] * len(e.squares)}
    for label, mask in masks.items():
        for engine in (am.Bisect(), Remesh()):
            yield Hostile(f"mark returns {label} to {type(engine).__name__}",
                          lambda m=mask, e=engine: _loop(mark=_Part(m), engine=e), "mark")
    for label, made in _meshes().items():
        # of other places than those of the mesh before the transfer speaks
        yield Hostile(f"engine returns {label}", lambda m=made: _loop(engine=_Part(m)),
                      "mesh" if label in ("elsewhere", "ten times as large") else "engine")
        if label in ("elsewhere", "ten times as large"):
            continue
        yield Hostile(f"intermediate returns {label}",
                      lambda m=made: _loop(engine=_Between(m), max_nodes=2000), "engine")
        if label not in ("elsewhere", "ten times as large"):
            yield Hostile(f"first returns {label}", lambda m=made: _loop(engine=_First(lambda size: m(_mesh()))),
                          "engine")


def _marking():
    for label, value in {"0": 0.0, "1.5": 1.5, "nan": NAN, "text": "0.5", "True": True, "None": None,
                         "list": [0.5]}.items():
        for cls in (Doerfler, Maximum):
            yield Hostile(f"{cls.__name__} {label}", lambda c=cls, v=value: c(v), "theta")
    for label, value in {"None": None, "text": "all", "nan": [1.0, NAN], "negative": [1.0, -1.0], "empty": [],
                         "matrix": np.eye(2), "complex": [1j], "class": am.Estimate}.items():
        for cls in (Doerfler, Maximum):
            yield Hostile(f"{cls.__name__} marks {label}", lambda c=cls, v=value: c().mark(v), "estimate")
    estimates = {"squares": (None, "a", [1.0, NAN], [-1.0], [], np.eye(2), [1j], [True, False], 3.0),
                 "norm": (None, NAN, -1.0, "1", True, [1.0]), "terms": (None, [1.0], {"a": "b"}, {3: 1.0}),
                 "value": ("1", NAN, True), "signed": ("1", NAN, True), "energy_error": ("1", NAN, -1.0, True),
                 "indicator": (3, None)}
    for name, given in estimates.items():
        for k, value in enumerate(given):
            whole = {"squares": [1.0], "norm": 1.0} | ({"value": 1.0, "signed": 0.0} if name in ("value", "signed")
                                                      else {})
            yield Hostile(f"Estimate {name} {k}", lambda w=whole | {name: value}: am.Estimate(**w), name)
    for name, given in {"growth": (1.0, NAN, True, "2", 0.5), "finest": (0.0, 1.0, NAN), "coarsest": (0.5, NAN, "x"),
                        "gradation": (0.0, 2.0, NAN), "refinements": (-1, 9, 1.5, True)}.items():
        for k, value in enumerate(given):
            yield Hostile(f"Remesh {name} {k}", lambda n=name, v=value: Remesh(**{n: v}), name)
    for engine in (am.Bisect(), Remesh()):
        name = type(engine).__name__
        rows = {"mesh": {"mesh": None}, "estimate": {"estimate": None}, "problem": {"problem": None},
                "squares" if name == "Remesh" else "estimate is of": {"estimate": am.Estimate(squares=[1.0], norm=1.0)}}
        for says, wrong in rows.items():
            yield Hostile(f"{name} {says}", lambda e=engine, w=wrong: _refined(e, **w), says)
        for label, most in {"0": 0, "text": "9", "True": True, "1.5": 1.5}.items():
            yield Hostile(f"{name} max_nodes {label}", lambda e=engine, v=most: _refined(e, max_nodes=v), "max_nodes")


def _refined(engine, **wrong):
    given = {"problem": _problem(), "mesh": _mesh(), "estimate": _estimate(),
             "marked": np.ones(len(_mesh().elements), dtype=bool)}
    return engine.refine(**(given | wrong))


def _goals():
    for label, value in {"None": None, "text": "u", "class": am.ContactForce, "empty": [], "number": 3,
                         "nested": [[am.ContactForce()]], "mixed": [am.ContactForce(), "u"]}.items():
        yield Hostile(f"goal of {label}", lambda v=value: am.Goal(v), "quantity")
    for name, given in {"rtol": (0.0, 2.0, NAN, "x", True), "max_iterations": (0, 1.5, True),
                        "direct_below": (-1, 1.5, True), "transitions": (-1.0, NAN, "x")}.items():
        for k, value in enumerate(given):
            yield Hostile(f"goal {name} {k}", lambda n=name, v=value: am.Goal(am.ContactForce(), **{n: v}), name)
    for label, value in {"None": None, "text": "A", "nan": (0.0, NAN), "one": (1.0,), "four": (0.0,) * 4, "empty": (),
                         "ragged": [(0.0, 0.0), (0.0,)], "complex": (0.0, 1j), "number": 3.0,
                         "True": (True, False)}.items():
        yield Hostile(f"points {label}", lambda v=value: am.Displacement(v, "x"), "points")
    for label, value in {"w": "w", "3": 3, "-1": -1, "None": None, "True": True, "half": 0.5}.items():
        yield Hostile(f"component {label}", lambda v=value: am.Displacement((0.0, 0.0), v), "component")
        yield Hostile(f"component {label} of a mean", lambda v=value: am.MeanDisplacement("top", v), "component")
        yield Hostile(f"direction {label}", lambda v=value: am.ContactForce("bottom", v), "direction")
    for cls in (am.ContactForce, am.Opening):
        for label, value in {"None": None, "number": 3, "empty": ""}.items():
            yield Hostile(f"{cls.__name__} boundary {label}", lambda c=cls, v=value: c(v), "boundary")
    for label, value in {"text": "A", "nan": (0.0, NAN), "empty": (), "number": 3.0, "matrix": np.eye(2)}.items():
        yield Hostile(f"opening at {label}", lambda v=value: am.Opening("bottom", v), "point")
    wrong = {"points": (am.Displacement((1.0, 1.0), "x"), am.Displacement((0.0, 0.0, 0.0), "x")),
             "component": (am.Displacement((0.0, 0.0), "z"), am.MeanDisplacement("top", 2)),
             "body": (am.Displacement((0.0, 0.0), "x", body="upper"),),
             "nowhere": (am.MeanDisplacement("nowhere", "x"), am.ContactForce("nowhere"), am.Opening("nowhere")),
             "top": (am.ContactForce("top"), am.Opening("top")),
             "direction": (am.ContactForce("bottom", "z"),),
             "point": (am.Opening("bottom", (1.0, 0.0)), am.Opening("bottom", (0.0, 0.0, 0.0)),
                       am.Opening("bottom", (0.01, 0.03)))}
    for says, given in wrong.items():
        for k, quantity in enumerate(given):
            yield Hostile(f"goal {says} {k}", lambda q=quantity: am.Goal(q).indicate(_grids(), _result()), says)
            yield Hostile(f"loop for goal {says} {k}", lambda q=quantity: _loop(indicator=am.Goal(q)), says)

    class Own:
        """A quantity of one's own."""

        def __init__(self, made):
            self.made = made

        def functionals(self, view):
            return self.made(view)

    for label, made in {"None": lambda v: None, "text": lambda v: "u", "empty": lambda v: [],
                        "numbers": lambda v: [1.0], "an array": lambda v: np.ones(3)}.items():
        yield Hostile(f"own quantity {label}", lambda m=made: am.Goal(Own(m)).indicate(_grids(), _result()), "quantity")
    spoilt = {"vector short": {"vector": lambda a: a[:-1]}, "vector nan": {"vector": lambda a: a * NAN},
              "vector text": {"vector": lambda a: "v"}, "bubbles None": {"bubbles": lambda a: None},
              "bubbles short": {"bubbles": lambda a: a[1:]}, "bubbles nan": {"bubbles": lambda a: a * NAN},
              "value nan": {"value": lambda a: NAN}, "value text": {"value": lambda a: "1"},
              "vector matrix": {"vector": lambda a: a[:, None]}}
    for label, changes in spoilt.items():
        def made(view, changes=changes):
            good = am.ContactForce().functionals(view)[0]
            return [replace(good, **{name: change(getattr(good, name)) for name, change in changes.items()})]
        yield Hostile(f"own functional {label}", lambda m=made: am.Goal(Own(m)).indicate(_grids(), _result()),
                      label.split()[0])


def _errors():
    def other():
        grids = am.Hierarchy.uniform(am.cases.greco_bar(top_pressure=1e7), (2, 4))
        return grids, am.solve(grids)

    def bare():
        discrete = _grids().finest.discrete
        return am.solve(am.DiscreteProblem(matrix=discrete.matrix, load=discrete.load, fixed=discrete.fixed,
                                           law=am.Coulomb(1.0), contact=discrete.contact), am.ActiveSet())

    for indicator in (Residual(), Recovery(), am.Goal(am.ContactForce())):
        name = type(indicator).__name__
        yield Hostile(f"{name} of nothing", lambda i=indicator: i.indicate(None, None), "hierarchy")
        yield Hostile(f"{name} without result", lambda i=indicator: i.indicate(_grids(), None), "result")
        yield Hostile(f"{name} of another mesh", lambda i=indicator: i.indicate(
            am.Hierarchy.uniform(_problem(), (2, 6)), _result()), "result")
        yield Hostile(f"{name} under other loads", lambda i=indicator: i.indicate(_grids(), other()[1]), "loads")
        yield Hostile(f"{name} of a bare result", lambda i=indicator: i.indicate(_grids(), bare()), "result")
        yield Hostile(f"{name} of nan", lambda i=indicator: i.indicate(_grids(), replace(
            _result(), displacement=_result().displacement * NAN)), "displacement")
    pair = {"None": None, "one": (1,), "text": "reference", "three": (1, 2, 3), "swapped": ("r", "h"),
            "class": Reference, "result": 3.0}
    for label, value in pair.items():
        yield Hostile(f"reference {label}", lambda v=value: energy_error(v, _result()),
                      "hierarchy" if label == "swapped" else "reference")
    for label, value in {"None": None, "text": "r", "class": am.Result}.items():
        yield Hostile(f"error of {label}", lambda v=value: energy_error((_grids(), _result()), v), "result")
        yield Hostile(f"tractions of {label}", lambda v=value: boundary_tractions(v, "bottom"), "result")
    yield Hostile("error of a bare result", lambda: energy_error((_grids(), _result()), bare()), "result")
    yield Hostile("tractions of a bare result", lambda: boundary_tractions(bare(), "bottom"), "result")
    yield Hostile("error of a pair", lambda: energy_error((_grids(), _result()), _patch()), "result")
    for label, value in {"nan": NAN, "negative": -1.0, "text": "x", "True": True}.items():
        yield Hostile(f"own_error {label}", lambda v=value: Reference.of(_grids(), _result(), own_error=v), "own_error")
    for label, value in {"unknown": "nowhere", "None": None, "number": 3, "empty": "", "list": ["bottom"]}.items():
        yield Hostile(f"tractions on {label}", lambda v=value: boundary_tractions(_result(), v), "boundary")


@cache
def _patch():
    grids = am.Hierarchy.graded(am.cases.two_block_patch(), (0.03,))
    return am.solve(grids, am.ActiveSet())


def _levels():
    given = _meshes()
    for label, made in given.items():
        if label not in ("elsewhere", "ten times as large", "hierarchy"):
            yield Hostile(f"append {label}", lambda m=made: _grids().append(m(_mesh())),
                          {"without names": "bound", "other bodies": "bound", "NaN": "points", "folded": "elements",
                           "with a hole": "facets"}.get(label, "mesh"), (TypeError, ValueError, FileNotFoundError))
    yield Hostile("append a hierarchy", lambda: _grids().append(_grids()), "mesh")
    yield Hostile("append a coarser mesh", lambda: _grids().append(_grids()[0].mesh), "mesh")
    yield Hostile("append None", lambda: _grids().append(None), "mesh")
    for label, value in {"-3": -3, "2": 2, "99": 99, "text": "0", "True": True, "1.0": 1.5, "None": None,
                         "list": [0]}.items():
        yield Hostile(f"without {label}", lambda v=value: _grids().without(v), "level")
    yield Hostile("without the only one", lambda: am.Hierarchy.uniform(_problem(), (2,)).without(0), "level")


INPUTS = (*_arguments(), *_parts(), *_marking(), *_goals(), *_errors(), *_levels())
