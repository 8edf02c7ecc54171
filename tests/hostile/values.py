"""Numbers, names and objects that cannot be what was meant; wrong types, argument by argument:
test_doors."""

import numpy as np
from arrays_and_matrices import contact as nodes
from arrays_and_matrices import discrete, grids
from hostile_table import Hostile, each, labelled, words

import adaptmg as am

NAN, _BAD = float("nan"), "\udc80"
SQUARE, CUBE = am.Rectangle(width=1, height=1), am.Box(width=1, depth=1, height=1)
ELASTIC = am.PlaneStrain(young=1e9, poisson=0.3)


def problem(**changes):
    parts = {
        "material": ELASTIC,
        "law": am.Coulomb(0.3),
        "domain": SQUARE,
        "contact": am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
        "loads": (am.Pressure("top", 1e6),),
        "supports": (am.Support("right", x=0.0),),
    }
    return am.ContactProblem(**(parts | changes))


def triangle(x=0.0, **options):
    make = am.Outline if options else am.Polygon
    return make(vertices=((0, 0), (1, 0), (x, 1)), boundaries=("a", "b", "c"), **options)


#: what is made, its keyword arguments, wrong values, and what else it needs: each check once
_KEYWORDS = (
    (am.PlaneStrain, "young", (-1.0, 1e300, 1e-300), {"poisson": 0.3}),
    (am.Rectangle, "width", (1e-200,), {"height": 1}),
    (am.Solid, "poisson", (NAN, np.nextafter(0.5, 1)), {"young": 1.0}),
    (am.Multigrid, "rtol", (1.0, 0.0), {}),
    (am.Support, "x", (1e200,), {"boundary": "right"}),
    (am.Traction, "components", ((1e300, 0.0),), {"boundary": "t"}),
    (am.InitialStrain, "components", ((1e300, 0.0),), {"body": "body"}),
    (am.LoadPath, "default", ([0.5, NAN],), {}),
    (am.ContactPair, "reach gap", (-1.0,), {"slave": "a", "master": "b"}),
    (am.SingleGrid, "omega", (2.0,), {}),
    (am.cases.greco_bar, "size", (NAN,), {}),
    (am.CoarseSolve, "atol", (1.0,), {}),
    (am.CoarseSolve, "rtol", (0,), {}),
    (am.Truncated, "recombine", (5,), {}),
    (am.Doerfler, "theta", (0.0,), {}),
    (am.Remesh, "growth", (1.0,), {}),
    (am.Estimate, "squares", ([-1.0], []), {"norm": 1.0}),
    (am.Estimate, "norm", (-1.0,), {"squares": [1.0]}),
    (am.Estimate, "signed", (NAN,), {"squares": [1.0], "norm": 1.0, "value": 1.0}),
    (am.Estimate, "terms", ({"a": "b"}, {3: 1.0}), {"squares": [1.0], "norm": 1.0}),
    (problem, "material", ({_BAD: ELASTIC}, am.PlaneStrain, {}, {"body": am.PlaneStrain}), {}),
    (problem, "loads", ({"top": am.Pressure("top", 1.0)},), {}),
    (discrete, "coupling", ("W",), {}),
    (discrete, "bodies", ([0, 1], {"a": np.array([0, 99])}, {"a": np.array([0.5])}), {}),
    (nodes, "names", ((_BAD,), "abc", ()), {}),
    (nodes, "masters", ((_BAD,),), {}),
    (am.Multigrid, "correction", (am.Monotone,), {}),
    (am.ActiveSet, "linear", (am.AMG,), {}),
    (am.ProjectedGaussSeidel, "order", (np.array(["forward", "backward"]),), {}),
    (am.StepFile, "path", ("a\0", 3), {}),
)
#: other arguments: what takes them, and wrong values
_CALLS = {
    "Coulomb friction": (lambda v: am.Coulomb(v).bounds(2), -1.0, 1e300),
    "Tresca limit": (lambda v: am.Tresca(v).bounds(2), -1.0),
    "LoadPath factors['top']": (
        lambda v: am.LoadPath({"top": v}),
        [1e300],
        [[1.0], [1.0, 2.0]],
        "12",
    ),
    "factors": (am.LoadPath, {_BAD: [1.0]}),
    "both be 0": (lambda v: am.Cycle(pre=v, post=v), 0),
    "Outline arcs[1]": (lambda v: triangle(arcs={1: (0, v)}), NAN),
    "Polygon vertices": (triangle, NAN),
    "graded size": (lambda v: am.mesh.graded(SQUARE, v), 0),
    "sized size": (lambda v: am.mesh.sized(SQUARE, v, 0.3), 1e-6),
    "structured divisions": (lambda v: am.mesh.structured(SQUARE, v), (2, 2, 2), 10**5, 10**400),
    "space divisions": (lambda v: am.mesh.structured(CUBE, v), 2**40),
    "divisions": (
        lambda v: am.Hierarchy.uniform(am.cases.greco_bar(), v),
        "24",
        (),
        (2.0, 4),
        (0, 4),
        range(2, 600),
    ),
    "from coarse to fine": (lambda v: am.Hierarchy.uniform(am.cases.greco_bar(), v), (4, 2)),
    "truncated finest": (lambda v: grids().truncated(finest=v), 5),
    "sized size_function": (
        lambda v: am.mesh.sized(SQUARE, v, 0.3),
        lambda x: -x[:, 0] - 1,
        lambda x: [1.0, 2.0],
    ),
    "loads[0]": (lambda v: problem(loads=(v,)), am.Support("top", x=0.0)),
    "obstacle": (lambda v: am.Contact("bottom", v), type("Data", (), {"contact": 5})()),
    "Assembly parts['a']": (lambda v: am.Assembly(parts={"a": v}), am.Rectangle),
    "levels[0]": (lambda v: am.Hierarchy(levels=(v,)), am.Level),
    "adapt start": (
        lambda v: am.adapt(am.cases.greco_bar(), v, max_nodes=9),
        NAN,
        0.0,
        "5 mm",
        [5e-3],
        1e-9,
        print,
    ),
    "resultant boundary": (lambda v: am.solve(grids()).resultant(v), 5),
}
#: meshes of more nodes than fit
_LARGE = {
    "square": lambda: am.mesh.graded(SQUARE, 1e-6),
    "ball": lambda: am.mesh.graded(am.Ball((0, 0, 0), 1), 1e-100),
    "ratio in space": lambda: am.mesh.graded(CUBE, 0.3, "top", 1e5),
    "round wire": lambda: am.mesh.graded(am.Cylinder((0, 0, 0), (0, 0, 1), 1e-6, 1), 1e-2),
}


def _named_contact(**changes):
    return problem(
        domain=am.Polygon(
            vertices=((0, 0), (1, 0), (1, 1), (0, 1)),
            boundaries=("bottom", "contact", "top", "left"),
        ),
        **changes,
    )


INPUTS = (
    *(
        row
        for make, names, values, given in _KEYWORDS
        for row in words(make, names, *values, **given)
    ),
    *(
        row
        for argument, (call, *values) in _CALLS.items()
        for row in each(
            argument, call, labelled(values), error=(TypeError, ValueError, FileNotFoundError)
        )
    ),
    *each("mesh", lambda make: make(), _LARGE, says="sizes ask for"),
    Hostile(
        "class law without parameters", lambda: problem(law=am.Frictionless), "Frictionless(...)"
    ),
    Hostile(
        "moduli 1e39 : 1",
        lambda: problem(
            material={
                name: am.PlaneStrain(young=young, poisson=0.3)
                for name, young in (("a", 1e39), ("b", 1.0))
            }
        ),
        "material: Young's moduli",
    ),
    # "contact" is the name of all contact boundaries
    *(
        Hostile(f"named contact: {name}", run, "'contact'")
        for name, run in {
            "a support": lambda: _named_contact(supports=(am.Support("contact", x=0.0),)),
            "one of two boundaries": lambda: _named_contact(
                contact=[
                    am.Contact(name, am.Plane((0, 0), (0, 1))) for name in ("bottom", "contact")
                ]
            ),
            "a master": lambda: _named_contact(contact=am.ContactPair("bottom", "contact")),
            "contact nodes": lambda: discrete(
                contact=nodes(names=("a", "contact"), boundary=[0, 1])
            ),
            "a master of nodes": lambda: discrete(
                contact=nodes(names=("a",), masters=("contact",))
            ),
        }.items()
    ),
)
