"""Names, choices, mappings and objects: a class for an instance, text for a sequence, another object altogether."""

from pathlib import Path

import numpy as np
from arrays_and_matrices import contact as nodes
from arrays_and_matrices import discrete, grids
from hostile_table import Hostile, each
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
    few = ("with a surrogate",)
    for argument, call in {
            "ContactProblem name": lambda v: problem(name=v), "Pressure boundary": lambda v: am.Pressure(v, 1.0),
            "DiscreteProblem name": lambda v: discrete(name=v), "ContactNodes names": lambda v: nodes(names=(v,)),
            "ContactNodes masters": lambda v: nodes(masters=(v,)), "Polygon boundaries": lambda v: triangle((v,) * 3),
            "LoadPath factors": lambda v: am.LoadPath({v: [1.0]}),
            "material": lambda v: problem(material={v: am.PlaneStrain(young=1.0, poisson=0.0)}),
            "ContactPair slave": lambda v: am.ContactPair(v, "b")}.items():
        yield from each(argument, call, NAMES, few)
    letters = {"letters": "abc", "None": None, "number": 5}
    yield from each("Polygon boundaries", triangle, letters)
    yield from each("ContactNodes names", lambda v: nodes(names=v), letters | {"empty": ()})
    yield from each("ContactNodes masters", lambda v: nodes(masters=v), letters, ("letters",))
    yield from each("resultant boundary", lambda v: am.solve(grids()).resultant(v), NAMES, ("a number",))
    yield Hostile("case unknown", lambda: am.cases.get("\ud800"), "there is no case")


def _choices():
    values = {"unknown": "glue", "surrogate": "\ud800", "list": ["forward"], "array": np.array(["forward", "backward"]),
              "None": None}
    yield from each("order", lambda v: am.ProjectedGaussSeidel(order=v), values)
    yield from each("ContactPair coupling", lambda v: am.ContactPair("a", "b", coupling=v), values, ("unknown",))
    yield from each("uniform diagonal", lambda v: am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4), diagonal=v),
                    values, ("unknown",))


#: what takes an instance, its class as the first of the wrong values
_OBJECTS = {
    "law": (lambda v: problem(law=v), am.Coulomb, None, 0.3), "domain": (lambda v: problem(domain=v), am.Rectangle),
    "material": (lambda v: problem(material=v), am.PlaneStrain, {"body": am.PlaneStrain}, {}),
    "contact": (lambda v: problem(contact=v), am.Contact, None, "bottom", (), 3),
    "loads": (lambda v: problem(loads=v), am.Pressure, None, 5.0, "top", {"top": am.Pressure("top", 1.0)}),
    "loads[0]": (lambda v: problem(loads=(v,)), am.Pressure, am.Support("top", x=0.0)),
    "supports": (lambda v: problem(supports=v), None),
    "supports[0]": (lambda v: problem(supports=(v,)), am.Support, am.Pressure("top", 1.0)),
    "reference": (lambda v: problem(reference=v), "x"),
    "obstacle": (lambda v: am.Contact("bottom", v), am.Plane, type("Data", (), {"contact": 5})()),
    "Assembly parts['a']": (lambda v: am.Assembly(parts={"a": v}), am.Rectangle),
    "Moved solid": (am.Moved, am.Ball), "Cut b": (lambda v: am.Cut(am.Ball((0, 0, 0), 1.0), v), am.Ball),
    "Revolution polygon": (am.Revolution, am.Polygon), "GapFunction function": (am.GapFunction, 0.0),
    "Traction components": (lambda v: am.Traction("top", v), 5.0), "BodyForce components": (am.BodyForce, None),
    "LoadPath factors": (am.LoadPath, "top"), "LoadPath factors['top']": (lambda v: am.LoadPath({"top": v}), None),
    "case law": (lambda v: am.cases.greco_bar(law=v), am.Coulomb),
    "DiscreteProblem law": (lambda v: discrete(law=v), am.Coulomb, "Coulomb"),
    "DiscreteProblem contact": (lambda v: discrete(contact=v), am.ContactNodes),
    "DiscreteProblem coupling": (lambda v: discrete(coupling=v), "W"),
    "DiscreteProblem bodies": (lambda v: discrete(bodies=v), [0, 1], {"a": np.array([0, 99])}, {"a": np.array([0.5])}),
    "coupled contact": (lambda v: discrete(make=am.DiscreteProblem.coupled, weights=sparse.csr_array((12, 12)),
                                           contact=v), None),
    "Multigrid cycle": (lambda v: am.Multigrid(cycle=v), am.Cycle, "V"),
    "Multigrid coarse": (lambda v: am.Multigrid(coarse=v), am.CoarseSolve),
    "Multigrid smoother": (lambda v: am.Multigrid(smoother=v), am.ProjectedGaussSeidel, None, "jacobi"),
    "Multigrid correction": (lambda v: am.Multigrid(correction=v), am.Truncated, am.Monotone, "monotone", object()),
    "FullMultigrid start": (lambda v: am.FullMultigrid(start=v), am.NestedStart),
    "ActiveSet linear": (lambda v: am.ActiveSet(linear=v), am.Direct, am.AMG, "direct"),
    "coarse_solve": (lambda v: am.Truncated(coarse_solve=v), am.Direct, "direct"),
    "coarse_smoother": (lambda v: am.Truncated(coarse_smoother=v), am.ProjectedGaussSeidel, "direct"),
    "solve grids": (am.solve, None, am.Hierarchy, am.cases.greco_bar()),
    "solver": (lambda v: am.solve(grids(), v), am.FullMultigrid, am.ActiveSet, "multigrid"),
    "solve callback": (lambda v: am.solve(grids(), callback=v), 5),
    "solve start": (lambda v: am.solve(grids(), am.Multigrid(), start=v), am.Result, "zero"),
    "solve reference": (lambda v: am.solve(grids(), reference=v), "exact"),
    "path": (lambda v: am.solve_path(grids(), v), am.LoadPath, [0.5, 1.0]),
    "path solver": (lambda v: am.solve_path(grids(), am.LoadPath(), v), am.FullMultigrid),
    **{f"path {name}": (lambda v, n=name: am.solve_path(grids(), am.LoadPath(), **{n: v}), wrong)
       for name, wrong in (("start", "zero"), ("callback", "print"), ("progress", 1))},
    "divisions": (lambda v: am.Hierarchy.uniform(am.cases.greco_bar(), v), None, "24", ("2", "4"), (), (None, 4)),
    "sizes": (lambda v: am.Hierarchy.graded(am.cases.greco_bar(), v), None, "0.01", ()),
    "uniform problem": (lambda v: am.Hierarchy.uniform(v, (2, 4)), None, am.ContactProblem),
    "from_meshes problem": (lambda v: am.Hierarchy.from_meshes(v, []), None),
    "graded problem": (lambda v: am.Hierarchy.graded(v, (0.01,)), None),
    "bisected problem": (lambda v: am.Hierarchy.bisected(v, grids()[0].mesh, 1), None),
    "meshes": (lambda v: am.Hierarchy.from_meshes(am.cases.greco_bar(), v), None, 5),
    "mesh": (lambda v: am.Hierarchy.from_meshes(am.cases.greco_bar(), [v]), 5, am.MeshArrays),
    "transfer": (lambda v: am.Hierarchy.from_meshes(am.cases.greco_bar(), [grids()[0].mesh], transfer=v), am.L2,
                 am.PseudoL2),
    "levels": (lambda v: am.Hierarchy(levels=v), None, "ab"),
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
    "StepFile path": (am.StepFile, "a\0", 3, Path),
}


def _objects():
    for argument, (call, *wrong) in _OBJECTS.items():
        yield from each(argument, call, {f"{getattr(v, '__name__', type(v).__name__)} {i}": v for i,
                    v in enumerate(wrong)})


def _named_contact(**changes):
    edges = am.Polygon(vertices=_SQUARE, boundaries=("bottom", "contact", "top", "left"))
    return problem(domain=edges, **changes)


INPUTS = (
    *_names(), *_choices(), *_objects(),
    Hostile("class law without parameters", lambda: problem(law=am.Frictionless), "Frictionless(...)"),
    Hostile("moduli 1e39 : 1", lambda: problem(material={name: am.PlaneStrain(young=young, poisson=0.3) for name, young
                                                         in (("a", 1e39), ("b", 1.0))}), "material: Young's moduli"),
    # "contact" is the name of all contact boundaries
    Hostile("support on a boundary named contact", lambda: _named_contact(
        supports=(am.Support("contact", x=0.0),)), "'contact'"),
    Hostile("one of two contact boundaries named contact", lambda: _named_contact(
        contact=[am.Contact(name, am.Plane((0, 0), (0, 1))) for name in ("bottom", "contact")]), "'contact'"),
    Hostile("a master named contact", lambda: _named_contact(contact=am.ContactPair("bottom", "contact")), "'contact'"),
    Hostile("one of several names of contact nodes", lambda: discrete(
        contact=nodes(names=("a", "contact"), boundary=[0, 1])), "'contact'"),
    Hostile("a master of contact nodes", lambda: discrete(
        make=am.DiscreteProblem.coupled, weights=sparse.csr_array(([0.5], ([0], [1])), shape=(12, 12)),
        contact=nodes(names=("a",), masters=("contact",))), "'contact'"),
)
