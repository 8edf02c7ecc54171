"""Every public class and function refuses values of another type for each argument and names that
argument."""

import dataclasses
import inspect
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arrays_and_matrices import contact, discrete, grids
from scipy import sparse

import adaptmg as am
from adaptmg import mesh as meshes

SQUARE = am.Polygon(
    vertices=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), boundaries=tuple("abcd")
)
BALL, PLANE = am.Ball((0.0, 0.0, 0.0), 1.0), am.Plane((0.0, 0.0), (0.0, 1.0))
UNIT = am.Rectangle(width=1, height=1)
ELASTIC = {"young": 1e9, "poisson": 0.3}
NAN, TEXT, OTHER = float("nan"), "\udc80", object()
#: wrong values by the type of a right one: its class, another object, and what a careless check lets pass
WRONG = {
    float: (
        NAN,
        True,
        "1",
        b"1",
        1j,
        float("inf"),
        None,
        [-1.0],
        [[1.0], [1.0, 2.0]],
        np.ma.masked,
        float,
        10**400,
    ),
    int: (2.5, 2.0, True, "2", None, NAN, -3, 10**400),
    bool: ("no", 1, None, np.ones(2)),
    str: (5, "", None, ["right"], "a\0b", "a\x1b", TEXT),
    tuple: (None, 5, (NAN, 1.0), (1.0, 1j), "ab", ((1.0,),)),
    list: (None, "glue", [OTHER]),
    dict: ({TEXT: 1.0}, 3, "a"),
}
FEW = {
    float: (NAN, True, "1"),
    int: (2.5, True, -3),
    bool: ("no",),
    str: (5, TEXT),
    tuple: (5, "a"),
    list: ("glue", [OTHER]),
    dict: (3,),
}
#: classes all of whose arguments get all wrong values: each kind of check is among them
THOROUGH = {am.Rectangle, am.Cycle, am.Support, am.Contact, am.SingleGrid, am.Plane, am.Coulomb}


@cache
def bar():
    return am.cases.greco_bar()


def mesh():
    return grids().finest.mesh


def mask():
    return np.ones(len(mesh().elements), dtype=bool)


def estimate():
    return am.Estimate(squares=np.ones(len(mesh().elements)), norm=1.0)


def line():
    return am.cases.HertzContact(load=1.0, radius=1.0, modulus=1.0)


def square(n):
    return {"m": n * n}


def studied(details=False, **given):
    return am.Study(square, {"n": [1]}, **given).table(details)


def adapted(**given):
    return list(am.adapt(bar(), 20e-3, **({"engine": am.Bisect(), "max_nodes": 60} | given)))


#: arguments that the fields of dataclasses take, by their names
FIELDS = {
    name: value
    for names, value in {
        "width depth height radius size base reach tangential unit norm value x at limit omega angle default": 1.0,
        "young": 1e9,
        "poisson friction grading": 0.3,
        "theta rotation": 0.5,
        "rtol": 0.1,
        "growth": 2.0,
        "cycles max_cycles max_steps max_sweeps passes pre post recombine interface_sweeps smooth": 2,
        "moment": 0.0,
        "path": Path("a.step"),
        "allow_interference nested_start condensed coarse_contact rigid_motions search": False,
        "boundary body name slave": "a",
        "master": "b",
        "component direction": "x",
        "coupling": "mortar",
        "shape": "V",
        "stop test": "error",
        "order": "forward",
        "coarse_matrices": "galerkin",
        "gap": "smallest",
        "slip": "initial",
        "components normal displacement": (0.0, 1.0),
        "point about origin points": (0.0, 0.0),
        "offset axis": (0.0, 0.0, 1.0),
        "centre": (0.0, 0.0, 0.0),
        "boundaries": tuple("abcd"),
        "vertices": SQUARE.vertices,
        "squares": (1.0,),
        "jump": (1, 1),
        "arcs rename reference terms": {},
        "parts": {"a": UNIT},
        "factors": {"top": [1.0]},
        "cracks": {"c": ((0.2, 0.5), (0.8, 0.5))},
        "force": (None, 1.0),
        "function": len,
        "obstacle": PLANE,
        "polygon domain": SQUARE,
        "solid a b": BALL,
        "law": am.Coulomb(0.3),
        "contact": am.Contact("a", PLANE),
        "material": am.PlaneStrain(**ELASTIC),
        "linear coarse_solve coarse_smoother": am.Direct(),
        "cycle correct": am.Cycle(),
        "smoother": am.ProjectedGaussSeidel(),
        "correction": am.Monotone(),
        "project": SimpleNamespace(project=lambda contact, before, after: after),
        "coarse": am.CoarseSolve(),
        "quantity": am.ContactForce(),
        "levels": lambda: grids().levels,
        "problem": bar,
        "mesh": mesh,
        "discrete": lambda: grids()[0].discrete,
    }.items()
    for name in names.split()
}
#: other ones, of some classes; None: not this one
OWN = {
    am.ContactPair: {"gap": None},
    am.Tresca: {},
    am.PyAMG: {"cycle": "V", "smoother": "sor"},
    am.State: {"unknowns": (0.0,), "passes": 2.0},
    am.PaperCorrection: {"limit": "initial"},
    am.Preload: {"force": 1.0, "axis": "y"},
    am.Spring: {"normal": 1.0},
    am.Support: {"normal": None, "name": None},
    am.Box: {"origin": (0.0, 0.0, 0.0)},
    am.Circle: {"centre": (0.0, 0.0)},
    am.Hierarchy: {"origin": None},
    am.Cylinder: {"point": (0.0, 0.0, 0.0)},
    am.SizeNear: {"points": ((0.0, 0.0),)},
    am.Periodic: {"slave": "b", "master": "a"},
    am.Estimate: {"value": None},
    am.FullMultigrid: {"stop": None},
    am.ContactProblem: {"loads": [am.Pressure("c", 1.0)], "supports": [am.Support("b", x=0.0)]},
}
RESULTS = {
    am.Certificate,
    am.GoalEstimate,
    am.MeshArrays,
    am.PathResult,
    am.Result,
    am.Step,
    am.ContactNodes,
    am.DiscreteProblem,
}


def arguments(kind):
    """Arguments that a public dataclass takes."""
    names = inspect.signature(kind).parameters
    right = {name: FIELDS[name] for name in names if name in FIELDS} | OWN.get(kind, {})
    return {name: value for name, value in right.items() if value is not None}


PUBLIC = {
    value for value in (getattr(am, name) for name in dir(am)) if dataclasses.is_dataclass(value)
} - RESULTS


def with_defaults(function):
    """The arguments of a function and their defaults, those that are None apart."""
    parameters = inspect.signature(function).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items()}
    return {name: value for name, value in defaults.items() if value is not None}


CASES = am.cases.CASES | am.cases.FROM_PYTHON
DESIGNS = (am.study.Sobol, am.study.LatinHypercube, am.study.Random)
#: a door and arguments that it takes
DOORS = {
    **{case.function: with_defaults(case.function) for case in CASES.values()},
    **{design: {"ranges": {"n": (0.0, 1.0)}, "runs": 2, "seed": 0} for design in DESIGNS},
    **{
        kind: arguments(kind)
        for kind in sorted(PUBLIC, key=lambda kind: kind.__name__)
        if arguments(kind)
    },
    am.solve: {"grids": grids, "solver": am.Multigrid(), "throw": True, "callback": len},
    am.solve_path: {
        "grids": grids,
        "path": am.LoadPath(),
        "solver": am.Multigrid(),
        "callback": len,
        "throw": True,
    },
    am.discretise: {"problem": bar, "mesh": mesh},
    adapted: {
        "tolerance": 0.1,
        "max_nodes": 9,
        "max_seconds": 1.0,
        "indicator": am.Residual(),
        "mark": am.Doerfler(),
        "engine": am.Bisect(),
        "solver": am.FullMultigrid(),
        "transfer": am.L2(),
        "load_path": am.LoadPath(),
        "adapt_on": "last",
        "progress": len,
        "store": Path("a"),
    },
    am.Hierarchy.uniform: {"problem": bar, "divisions": [2, 4]},
    am.Hierarchy.graded: {
        "problem": bar,
        "sizes": [0.01],
        "contact_ratio": 1.0,
        "transfer": am.L2(),
    },
    am.Hierarchy.from_meshes: {
        "problem": bar,
        "meshes": lambda: [mesh()],
        "transfer": am.L2(),
        "contact_rows": True,
    },
    am.Hierarchy.single: {"discrete": discrete},
    am.Hierarchy.from_prolongations: {"discrete": discrete, "prolongations": [np.eye(3)]},
    am.Hierarchy.algebraic: {"discrete": discrete, "max_coarse": 9},
    grids().append: {"mesh": mesh},
    grids().without: {"level": 1},
    grids().truncated: {"coarsest": 0},
    mesh().boundary_facets: {"boundary": "top"},
    mesh().boundary_nodes: {"boundary": "top"},
    mesh().surface: {"boundary": "top"},
    grids().forecast: {"finer": 1.0},
    grids().with_problem: {"problem": bar},
    grids().finest.prolong: {"u": lambda: np.zeros((9, 2))},
    grids().finest.inject: {"u": lambda: np.zeros((9, 2))},
    grids().finest.restrict: {"r": lambda: np.zeros((25, 2))},
    discrete: {"law": am.Coulomb(0.3), "contact": contact(), "name": "a", "bodies": {}},
    contact: {"allow_interference": False, "names": ("a",), "masters": ("b",)},
    meshes.structured: {"domain": UNIT, "divisions": 2},
    meshes.graded: {
        "domain": UNIT,
        "size": 0.5,
        "contact_boundaries": "top",
        "contact_ratio": 1.0,
        "grading": 0.3,
    },
    meshes.sized: {"domain": UNIT, "size_function": 0.5, "max_size": 0.5},
    meshes.as_mesh: {"mesh": mesh},
    meshes.check_mesh: {"mesh": mesh},
    meshes.merged: {"meshes": lambda: {"a": mesh()}},
    meshes.bisect: {"mesh": mesh, "marked": mask, "passes": 2},
    meshes.refine_near: {"mesh": mesh, "boundaries": "top", "levels": 2},
    am.Doerfler().mark: {"estimate": estimate},
    meshes.quality: {"mesh": mesh},
    am.discrete.stiffness: {
        "mesh": mesh,
        "material": am.PlaneStrain(**ELASTIC),
        "elements": "linear",
    },
    am.discrete.rigid_motions: {"mesh": mesh, "axisymmetric": False},
    am.discrete.load_vector: {"mesh": mesh, "loads": [am.Pressure("top", 1.0)]},
    am.discrete.element_strain: {"mesh": mesh, "displacement": np.zeros(50)},
    am.transfer.galerkin_product: {
        "matrix": lambda: grids().finest.discrete.matrix,
        "nodal": sparse.csr_array(np.eye(25)),
    },
    am.transfer.PointLocator: {"mesh": mesh},
    am.transfer.mesh_ratio: {"coarse": mesh, "fine": mesh},
    am.transfer.size_ratio: {"coarse": mesh, "fine": mesh},
    am.plot.deformation: {
        "result": lambda: am.solve(grids()),
        "stress": False,
        "states": False,
        "lines": True,
        "bodies": ["body"],
    },
    am.plot.mesh: {"drawn": mesh, "contact": ["top"]},
    am.plot.grids: {"hierarchy": grids},
    am.plot.problem: {"posed": bar, "mesh": mesh},
    am.plot.history: {"results": lambda: am.solve(grids()), "against": "work_units"},
    am.export.vtk: {"result": lambda: am.solve(grids()), "path": Path("a.vtu")},
    am.study.as_text: {"table": {"a": [1.0]}, "units": {}, "formats": {}},
    am.cases.HertzContact: {"load": 1.0, "radius": 1.0, "modulus": 1.0, "point": False},
    am.cases.PartialSlip: {"normal": line(), "friction": 0.3, "tangential": 0.1},
    studied: {"fixed": {}, "depends": {}, "details": False},
    am.Bisect().refine: {
        "problem": bar,
        "mesh": mesh,
        "estimate": estimate,
        "max_nodes": 9,
        "marked": mask,
    },
    am.Remesh().refine: {"problem": bar, "mesh": mesh, "estimate": estimate, "max_nodes": 9},
    **{
        indicator.indicate: {"hierarchy": grids, "result": lambda: am.solve(grids())}
        for indicator in (am.Residual(), am.Recovery(), am.Goal(am.ContactForce()))
    },
}


def inverted():
    box = am.mesh.structured(am.Box(width=1, depth=1, height=1), 2)
    elements = box.elements.copy()
    elements[3] = elements[3][[1, 0, 2, 3]]
    return am.MeshArrays(box.points, elements, box.facets, box.facet_labels, box.boundaries)


def damaged():
    nodal = sparse.csr_array(np.eye(25))
    nodal.indices[7] = 10**9
    return nodal


def solved(discrete=False):
    return grids().finest.discrete if discrete else am.solve(grids())


def computed():
    study = am.Study(square, {"n": [1]})
    study.run(progress=False)
    return study


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: meshes.quality(inverted()), "inverted"),
        (lambda: am.discrete.load_vector(inverted(), [am.Pressure("top", 1.0)]), "inverted"),
        (lambda: am.transfer.galerkin_product(grids().finest.discrete.matrix, damaged()), "nodal"),
        (lambda: am.plot.mesh(mesh(), contact="nobody"), "contact must be one of"),
        (lambda: am.discrete.stiffness(mesh(), am.PlaneStrain(**ELASTIC), "nobody"), "elements"),
        (lambda: am.Hierarchy.graded(bar(), sizes=(20e-3,), grading=True), "grading"),
        (lambda: computed().run(rerun=True, cost="nobody"), "cost must be a function, or the name"),
        (lambda: am.Study(square, {"n": [1]}).run(progress=False, cost="nobody"), "cost must name"),
        (lambda: am.Periodic("left", "right", jump=[]), "jump must have 2 or 3"),
        (lambda: am.Coulomb([]), "friction must be a number"),
        (lambda: am.Tresca([]), "limit must be a number"),
        (lambda: am.study.as_text({"n": [1]}, units={"n": 3}), r"units\['n'\] must be a text"),
        (lambda: am.export.Report("a", "b").card("c", units=3), "units and formats are those of"),
        (lambda: solved().certificate(bound=None), "bound must be True or False"),
        (lambda: am.smoother.local_system(solved(True), 3), "system must be LocalSystem"),
        (lambda: am.discrete.fixed_dofs(mesh(), 3), "supports must be a sequence"),
        (lambda: am.transfer.without_fixed(solved(True).matrix, [1]), "fixed must be a boolean"),
        (lambda: meshes.structured(am.Rectangle(width=1, height=1), dict), "divisions must be"),
        (lambda: computed().load({}), "row must have all parameters"),
        (lambda: am.DiscreteProblem(**posed(inclined=True)), "inclined"),
        (lambda: am.cases.get([]), "name must be a string"),
        (lambda: am.solve(grids()).resultant([]), "boundary must be a string"),
        (lambda: am.solve_path(grids(), am.LoadPath(), depends=3), "depends must map"),
        (lambda: am.Step.table([3]), r"steps\[0\] must be Step"),
        (lambda: am.Bounds(lower=1.0, upper=0.5), "lower must be <= upper, got 1.0 and 0.5"),
        (lambda: am.Bounds(upper="1"), "upper must be an array of real numbers, got '1'"),
        (lambda: am.Bounds(weights=OTHER), "weights must be an array of real numbers"),
        (lambda: am.ScalarProblem(conductivity=0), "conductivity must be > 0, got 0"),
        (
            lambda: am.ScalarProblem(domain=UNIT, held=("lft",)),
            "held must be one of .*'left'.* got 'lft'",
        ),
        (lambda: am.Contact("a", PLANE, law=am.Tresca([1.0])), "limit of law must be a number"),
        (lambda: line().pressure([0.0, NAN]), "distance must be finite"),
        (lambda: solved().certificate().contradictions(NAN), "rtol must be finite, got nan"),
        (lambda: am.solve_path(grids(), am.LoadPath()).count(OTHER), "value must be Result"),
    ],
)
def test_what_no_type_shows_is_refused_by_name(call, says):
    with pytest.raises((TypeError, ValueError), match=says):
        call()


def test_an_error_in_a_function_of_the_user_names_its_place():
    push = am.Traction("top", (0.0, lambda x: x[:, 7]))
    problem = dataclasses.replace(bar(), loads=(push,), reference={})
    with pytest.raises(IndexError) as error:
        am.discretise(problem, mesh())
    assert "component y of Traction on 'top'" in error.value.__notes__[0]


def posed(**changes):
    one = grids().finest.discrete
    names = ("matrix", "load", "fixed", "law", "contact")
    return {name: getattr(one, name) for name in names} | changes


#: what messages say instead of the name
SAYS = {"coarsest": "", "meshes": "mesh", "sizes": "size"}


def wrong(door, value):
    yield OTHER
    kind = next((kind for kind in (bool, *WRONG) if isinstance(value, kind)), None)
    if kind is not None:
        yield from (WRONG if door in THOROUGH else FEW)[kind]
    elif not callable(value):
        yield type(value)


@pytest.mark.parametrize("door", DOORS, ids=lambda door: getattr(door, "__qualname__", "?"))
def test_each_argument_is_checked(door, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    right = {
        name: value() if inspect.isfunction(value) or hasattr(value, "cache_info") else value
        for name, value in DOORS[door].items()
    }
    for name, value in right.items():
        for other in wrong(door, value):
            with pytest.raises((TypeError, ValueError, FileNotFoundError)) as error:
                door(**right | {name: other})
            assert SAYS.get(name, name) in str(error.value), (name, other)
    assert not list(tmp_path.iterdir())
