"""Names, choices, mappings and objects: a class for an instance, text for a sequence, another object altogether."""

from pathlib import Path

import numpy as np
from arrays_and_matrices import contact as nodes
from arrays_and_matrices import discrete, grids
from hostile_table import Hostile, each, labelled, words
from scipy import sparse

import adaptmg as am

_BAD = "\udc80"
_SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))


def problem(**changes):
    parts = {"material": am.PlaneStrain(young=1e9, poisson=0.3), "law": am.Coulomb(0.3),
             "domain": am.Rectangle(width=1.0, height=1.0),
             "contact": am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
             "loads": (am.Pressure("top", 1e6),), "supports": (am.Support("right", x=0.0),)}
    return am.ContactProblem(**(parts | changes))


#: keyword arguments whose checks are their own
_KEYWORDS = {
    problem: {
        "material": ({_BAD: am.PlaneStrain(young=1.0, poisson=0.0)}, am.PlaneStrain, {}, {"body": am.PlaneStrain}),
        "contact": ((),), "loads": ({"top": am.Pressure("top", 1.0)},), "reference": ("x",)},
    discrete: {"coupling": ("W",), "bodies": ([0, 1], {"a": np.array([0, 99])}, {"a": np.array([0.5])})},
    nodes: {"names": ((_BAD,), "abc", ()), "masters": ((_BAD,), "abc")},
    am.LoadPath: {"factors": ({_BAD: [1.0]}, "top")}, am.Multigrid: {"correction": (am.Monotone, object())},
    am.ActiveSet: {"linear": (am.Direct, am.AMG)},
    am.ProjectedGaussSeidel: {"order": (np.array(["forward", "backward"]),)}, am.StepFile: {"path": ("a\0", 3, Path)},
}
#: other arguments: what takes them, and wrong values
_OBJECTS = {
    "loads[0]": (lambda v: problem(loads=(v,)), am.Pressure, am.Support("top", x=0.0)),
    "obstacle": (lambda v: am.Contact("bottom", v), type("Data", (), {"contact": 5})()),
    "Assembly parts['a']": (lambda v: am.Assembly(parts={"a": v}), am.Rectangle),
    "divisions": (lambda v: am.Hierarchy.uniform(am.cases.greco_bar(), v), "24", ("2", "4"), (), (None, 4)),
    "levels[0]": (lambda v: am.Hierarchy(levels=(v,)), 1, am.Level, discrete),
    "solve start": (lambda v: am.solve(grids(), start=v), am.Result, "zero"),
    "solve reference": (lambda v: am.solve(grids(), reference=v), "exact"),
    "adapt start": (lambda v: am.adapt(am.cases.greco_bar(), v, max_nodes=9), float("nan"), 0.0, "5 mm", True, [5e-3],
                    1e-9, np.eye(3), am.MeshArrays, print),
    "resultant boundary": (lambda v: am.solve(grids()).resultant(v), 5),
}


def _objects():
    for make, names in _KEYWORDS.items():
        for name, wrong in names.items():
            yield from words(make, name, *wrong)
    for argument, (call, *wrong) in _OBJECTS.items():
        yield from each(argument, call, labelled(wrong), error=(TypeError, ValueError, FileNotFoundError))
    yield Hostile("case unknown", lambda: am.cases.get("\ud800"), "there is no case")


def _named_contact(**changes):
    edges = am.Polygon(vertices=_SQUARE, boundaries=("bottom", "contact", "top", "left"))
    return problem(domain=edges, **changes)


INPUTS = (
    *_objects(),
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
