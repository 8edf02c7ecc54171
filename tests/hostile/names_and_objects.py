"""Names, choices, mappings and objects: a class for an instance, text for a sequence, another object altogether."""

from pathlib import Path

import numpy as np
from arrays_and_matrices import contact as nodes
from arrays_and_matrices import discrete, grids
from hostile_table import Hostile, each, labelled, words
from scipy import sparse

import adaptmg as am
from adaptmg.mesh import graded, structured

NAMES = {"a number": 5, "None": None, "empty": "", "a list": ["right"], "with a zero byte": "a\0b",
         "with a control character": "a\x1b", "with a surrogate": "\udc80"}
_SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))


def problem(**changes):
    parts = {"material": am.PlaneStrain(young=1e9, poisson=0.3), "law": am.Coulomb(0.3),
             "domain": am.Rectangle(width=1.0, height=1.0),
             "contact": am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
             "loads": (am.Pressure("top", 1e6),), "supports": (am.Support("right", x=0.0),)}
    return am.ContactProblem(**(parts | changes))


def triangle(boundaries):
    return am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=boundaries)


def _names():
    yield from each("Support boundary", lambda v: am.Support(v, x=0.0), NAMES)
    few = NAMES["with a surrogate"]
    for make, name, given in ((problem, "name", {}), (am.Pressure, "boundary", {"value": 1.0}), (discrete, "name", {}),
                              (am.ContactPair, "slave", {"master": "b"})):
        yield from words(make, name, few, **given)
    yield from words(problem, "material", {few: am.PlaneStrain(young=1.0, poisson=0.0)}, am.PlaneStrain, {},
                     {"body": am.PlaneStrain})
    yield from words(triangle, "boundaries", (few,) * 3, "abc", None, 5)
    yield from words(nodes, "names", (few,), "abc", None, 5, ())
    yield from words(nodes, "masters", (few,), "abc")
    yield from words(am.LoadPath, "factors", {few: [1.0]}, "top")
    yield from each("resultant boundary", lambda v: am.solve(grids()).resultant(v), NAMES, ("a number",))
    yield Hostile("case unknown", lambda: am.cases.get("\ud800"), "there is no case")


def _choices():
    yield from words(am.ProjectedGaussSeidel, "order", "glue", "\ud800", ["forward"], None,
                     np.array(["forward", "backward"]))
    yield from words(am.ContactPair, "coupling", "glue", slave="a", master="b")
    yield from words(am.Hierarchy.uniform, "diagonal", "glue", problem=bar(), divisions=(2, 4))


def bar():
    return am.cases.greco_bar()


#: keyword arguments that take an instance, with wrong values: often its class
_KEYWORDS = {
    problem: {
        "law": (am.Coulomb, None, 0.3), "domain": (am.Rectangle,), "contact": (am.Contact, None, "bottom", (), 3),
        "loads": (am.Pressure, None, 5.0, "top", {"top": am.Pressure("top", 1.0)}), "supports": (None,),
        "reference": ("x",)},
    discrete: {"law": (am.Coulomb, "Coulomb"), "contact": (am.ContactNodes,), "coupling": ("W",),
               "bodies": ([0, 1], {"a": np.array([0, 99])}, {"a": np.array([0.5])})},
    am.Multigrid: {"cycle": (am.Cycle, "V"), "coarse": (am.CoarseSolve,),
                   "smoother": (am.ProjectedGaussSeidel, None, "jacobi"),
                   "correction": (am.Truncated, am.Monotone, "monotone", object())},
    am.FullMultigrid: {"start": (am.NestedStart,)}, am.ActiveSet: {"linear": (am.Direct, am.AMG, "direct")},
    am.Truncated: {"coarse_solve": (am.Direct, "direct"), "coarse_smoother": (am.ProjectedGaussSeidel, "direct")},
    am.Hierarchy: {"levels": (None, "ab")}, am.GapFunction: {"function": (0.0,)}, am.cases.greco_bar: {
        "law": (am.Coulomb,)}, am.BodyForce: {"components": (None,)},
    am.StepFile: {"path": ("a\0", 3, Path)}, am.Revolution: {"polygon": (am.Polygon,)}, am.Moved: {"solid": (am.Ball,)},
}
_SOLVES = {
    "solver": (am.FullMultigrid, am.ActiveSet, "multigrid"), "callback": (5,), "start": (am.Result, "zero"),
    "reference": ("exact",)}
_PATHS = {"path": (am.LoadPath, [0.5, 1.0]), "solver": (am.FullMultigrid,), "start": ("zero",), "callback": ("print",),
          "progress": (1,)}
#: other arguments: what takes them, and wrong values
_OBJECTS = {
    "loads[0]": (lambda v: problem(loads=(v,)), am.Pressure, am.Support("top", x=0.0)),
    "supports[0]": (lambda v: problem(supports=(v,)), am.Support, am.Pressure("top", 1.0)),
    "obstacle": (lambda v: am.Contact("bottom", v), am.Plane, type("Data", (), {"contact": 5})()),
    "Assembly parts['a']": (lambda v: am.Assembly(parts={"a": v}), am.Rectangle),
    "Cut b": (lambda v: am.Cut(am.Ball((0, 0, 0), 1.0), v), am.Ball),
    "Traction components": (lambda v: am.Traction("top", v), 5.0),
    "LoadPath factors['top']": (lambda v: am.LoadPath({"top": v}), None),
    "coupled contact": (lambda v: discrete(make=am.DiscreteProblem.coupled, weights=sparse.csr_array((12, 12)),
                                           contact=v), None),
    "solve grids": (am.solve, None, am.Hierarchy, bar()),
    "divisions": (lambda v: am.Hierarchy.uniform(bar(), v), None, "24", ("2", "4"), (), (None, 4)),
    "sizes": (lambda v: am.Hierarchy.graded(bar(), v), None, "0.01", ()),
    "uniform problem": (lambda v: am.Hierarchy.uniform(v, (2, 4)), None, am.ContactProblem),
    "from_meshes problem": (lambda v: am.Hierarchy.from_meshes(v, []), None),
    "graded problem": (lambda v: am.Hierarchy.graded(v, (0.01,)), None),
    "bisected problem": (lambda v: am.Hierarchy.bisected(v, grids()[0].mesh, 1), None),
    "meshes": (lambda v: am.Hierarchy.from_meshes(bar(), v), None, 5),
    "mesh": (lambda v: am.Hierarchy.from_meshes(bar(), [v]), 5, am.MeshArrays),
    "transfer": (lambda v: am.Hierarchy.from_meshes(bar(), [grids()[0].mesh], transfer=v), am.L2, am.PseudoL2),
    "levels[0]": (lambda v: am.Hierarchy(levels=(v,)), 1, am.Level, discrete),
    "Hierarchy problem": (lambda v: am.Hierarchy(levels=grids().levels, problem=v), "bar"),
    "Level discrete": (am.Level, None, sparse.eye_array(4)),
    "Level mesh": (lambda v: am.Level(discrete=grids()[0].discrete, mesh=v), "mesh.vol"),
    "from_prolongations discrete": (lambda v: am.Hierarchy.from_prolongations(v, [np.eye(3)]), am.DiscreteProblem,
                                    None),
    "algebraic discrete": (am.Hierarchy.algebraic, am.DiscreteProblem),
    "single discrete": (am.Hierarchy.single, None, sparse.eye_array(24)),
    "structured domain": (lambda v: structured(v, 2), None, "square", am.Rectangle),
    "graded domain": (lambda v: graded(v, 0.1), None, 3, am.Rectangle),
}


def _objects():
    for make, names in _KEYWORDS.items():
        for name, wrong in names.items():
            yield from words(make, name, *wrong)
    for solve, names, given in ((am.solve, _SOLVES, {}), (am.solve_path, _PATHS, {"path": am.LoadPath()})):
        for name, wrong in names.items():
            yield from each(f"{solve.__name__} {name}", lambda v, s=solve, n=name, g=given: s(grids(), **(g | {n: v})),
                            labelled(wrong))
    for argument, (call, *wrong) in _OBJECTS.items():
        yield from each(argument, call, labelled(wrong))


def _named_contact(**changes):
    edges = am.Polygon(vertices=_SQUARE, boundaries=("bottom", "contact", "top", "left"))
    return problem(domain=edges, **changes)


INPUTS = (
    *_names(), *_choices(), *_objects(),
    Hostile("class law without parameters", lambda: problem(law=am.Frictionless), "Frictionless(...)"),
    Hostile("moduli 1e39 : 1", lambda: problem(material={name: am.PlaneStrain(young=young, poisson=0.3) for name, young
                                                         in (("a", 1e39), ("b", 1.0))}), "material: Young's moduli"),
    # "contact" is the name of all contact boundaries
    *(Hostile(f"named contact: {name}", run, "'contact'") for name, run in {
        "a support": lambda: _named_contact(supports=(am.Support("contact", x=0.0),)),
        "one of two boundaries": lambda: _named_contact(
            contact=[am.Contact(name, am.Plane((0, 0), (0, 1))) for name in ("bottom", "contact")]),
        "a master": lambda: _named_contact(contact=am.ContactPair("bottom", "contact")),
        "contact nodes": lambda: discrete(contact=nodes(names=("a", "contact"), boundary=[0, 1])),
        "a master of nodes": lambda: discrete(
            make=am.DiscreteProblem.coupled, weights=sparse.csr_array(([0.5], ([0], [1])), shape=(12, 12)),
            contact=nodes(names=("a",), masters=("contact",)))}.items()),
)
