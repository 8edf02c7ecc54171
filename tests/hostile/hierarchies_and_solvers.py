"""Hierarchies, options of solvers and the arguments of solve that cannot be what was meant."""

import numpy as np
from hostile_table import Hostile
from scipy import sparse

import adaptmg as am


def _uniform(divisions, **options):
    return am.Hierarchy.uniform(am.cases.greco_bar(), divisions, **options)


def _grids():
    return _uniform((2, 4))


def _solved(**arguments):
    return am.solve(_grids(), **arguments)


def _level(**changes):
    fine = _grids()[1]
    return am.Level(**({"discrete": fine.discrete, "mesh": fine.mesh, "prolongation": fine.prolongation} | changes))


def _levels(**changes):
    return am.Hierarchy(levels=(_grids()[0], _level(**changes)))


def _broken(matrix):
    matrix = sparse.csr_array(matrix).copy()
    matrix.indices = np.array(matrix.indices)
    matrix.indices[3] = 10**7
    return matrix


def _options():
    makers = {
        "SingleGrid": am.SingleGrid, "Multigrid": am.Multigrid, "FullMultigrid": am.FullMultigrid,
        "ActiveSet": am.ActiveSet,
    }
    for label, value in {"1e30": 1e30, "1": 1.0, "0": 0.0, "-1": -1.0, "nan": np.nan, "True": True, "text": "1e-8",
                         "None": None, "complex": 1j, "list": [1e-8]}.items():
        for name, make in makers.items():
            yield Hostile(f"{name} rtol {label}", lambda m=make, v=value: m(rtol=v), "rtol")
        yield Hostile(f"nested rtol {label}", lambda v=value: am.NestedStart(rtol=v), "rtol")
        if label not in ("0",):
            yield Hostile(f"coarse rtol {label}", lambda v=value: am.CoarseSolve(rtol=v), "rtol")
    for label, value in {"True": True, "float": 2.0, "text": "2"}.items():
        yield Hostile(f"max_cycles {label}", lambda v=value: am.Multigrid(max_cycles=v), "max_cycles")
        yield Hostile(f"max_sweeps {label}", lambda v=value: am.SingleGrid(max_sweeps=v), "max_sweeps")
        yield Hostile(f"max_steps {label}", lambda v=value: am.ActiveSet(max_steps=v), "max_steps")
        yield Hostile(f"pre {label}", lambda v=value: am.Cycle(pre=v), "pre")
        yield Hostile(f"recombine {label}", lambda v=value: am.Truncated(recombine=v), "recombine")
        yield Hostile(f"interface_sweeps {label}", lambda v=value: am.Truncated(interface_sweeps=v), "interface_sweeps")
        yield Hostile(f"friction_update {label}", lambda v=value: am.ProjectedGaussSeidel(friction_update=v),
                      "friction_update")


INPUTS = (
    *_options(),
    Hostile("condensed text", lambda: am.SingleGrid(condensed="no"), "condensed"),
    Hostile("condensed number", lambda: am.CoarseSolve(condensed=0), "condensed"),
    Hostile("cycle class", lambda: am.Multigrid(cycle=am.Cycle), "cycle"),
    Hostile("cycle text", lambda: am.Multigrid(cycle="V"), "cycle"),
    Hostile("coarse class", lambda: am.Multigrid(coarse=am.CoarseSolve), "coarse"),
    Hostile("start class", lambda: am.FullMultigrid(start=am.NestedStart), "start"),
    Hostile("nested cycles text", lambda: am.NestedStart(cycles="all"), "cycles"),
    Hostile("omega text", lambda: am.ProjectedGaussSeidel(omega="1"), "omega"),
    Hostile("omega True", lambda: am.SingleGrid(omega=True), "omega"),
    Hostile("max_iterations text", lambda: am.AMG(max_iterations="10"), "max_iterations"),
    Hostile("max_iterations True", lambda: am.AMG(max_iterations=True), "max_iterations"),
    Hostile("order surrogate", lambda: am.ProjectedGaussSeidel(order="\ud800"), "order"),
    Hostile("order list", lambda: am.ProjectedGaussSeidel(order=["forward"]), "order"),
    Hostile("order array", lambda: am.ProjectedGaussSeidel(order=np.array(["forward", "backward"])), "order"),
    # solve
    Hostile("grids None", lambda: am.solve(None), "grids"),
    Hostile("grids class", lambda: am.solve(am.Hierarchy), "grids"),
    Hostile("grids problem", lambda: am.solve(am.cases.greco_bar()), "grids"),
    Hostile("throw text", lambda: _solved(throw="no"), "throw"),
    Hostile("callback number", lambda: _solved(callback=5), "callback"),
    Hostile("start text", lambda: _solved(solver=am.Multigrid(), start="zero"), "start"),
    Hostile("start complex", lambda: _solved(solver=am.Multigrid(), start=np.full((25, 2), 1j)), "start"),
    Hostile("start bools", lambda: _solved(solver=am.Multigrid(), start=np.zeros((25, 2), dtype=bool)), "start"),
    Hostile("start strings", lambda: _solved(solver=am.Multigrid(), start=np.full((25, 2), "0")), "start"),
    Hostile("start nan", lambda: _solved(solver=am.Multigrid(), start=np.full((25, 2), np.nan)), "start"),
    Hostile("start short", lambda: _solved(solver=am.Multigrid(), start=np.zeros((3, 2))), "start"),
    Hostile("start 1e300", lambda: _solved(solver=am.Multigrid(), start=np.full((25, 2), 1e300)), "start"),
    Hostile("start class for solve", lambda: _solved(solver=am.Multigrid(), start=am.Result), "start"),
    Hostile("start ragged", lambda: _solved(solver=am.Multigrid(), start=[[1.0], [1.0, 2.0]]), "start"),
    Hostile("reference text", lambda: _solved(reference="exact"), "reference"),
    Hostile("reference complex", lambda: _solved(reference=np.full((25, 2), 1j)), "reference"),
    Hostile("path class", lambda: am.solve_path(_grids(), am.LoadPath), "path"),
    Hostile("path list", lambda: am.solve_path(_grids(), [0.5, 1.0]), "path"),
    Hostile("path start text", lambda: am.solve_path(_grids(), am.LoadPath(), start="zero"), "start"),
    Hostile("path throw text", lambda: am.solve_path(_grids(), am.LoadPath(), throw="no"), "throw"),
    Hostile("path callback text", lambda: am.solve_path(_grids(), am.LoadPath(), callback="print"), "callback"),
    Hostile("path progress number", lambda: am.solve_path(_grids(), am.LoadPath(), progress=1), "progress"),
    Hostile("points of probe complex", lambda: _solved().probe([[1j, 0.0]]), "points"),
    Hostile("points of probe text", lambda: _solved().probe([["0", "0"]]), "points"),
    Hostile("points of probe None", lambda: _solved().probe(None), "points"),
    Hostile("boundary of resultant number", lambda: _solved().resultant(5), "boundary"),
    Hostile("about text", lambda: _solved().resultant("contact", about=["0", "0"]), "about"),
    # hierarchies
    Hostile("divisions None", lambda: _uniform(None), "divisions"),
    Hostile("divisions text", lambda: _uniform("24"), "divisions"),
    Hostile("divisions of text", lambda: _uniform(("2", "4")), "divisions"),
    Hostile("divisions floats", lambda: _uniform((2.0, 4.0)), "divisions"),
    Hostile("divisions True", lambda: _uniform((True, 4)), "divisions"),
    Hostile("divisions zero", lambda: _uniform((0, 4)), "divisions"),
    Hostile("divisions empty", lambda: _uniform(()), "divisions"),
    Hostile("divisions fine to coarse", lambda: _uniform((4, 2)), "coarse to fine"),
    Hostile("divisions endless", lambda: _uniform(range(2, 600)), "divisions"),
    Hostile("divisions None inside", lambda: _uniform((None, 4)), "divisions"),
    Hostile("diagonal text", lambda: _uniform((2, 4), diagonal="up"), "diagonal"),
    Hostile("problem None", lambda: am.Hierarchy.uniform(None, (2, 4)), "problem"),
    Hostile("problem class", lambda: am.Hierarchy.uniform(am.ContactProblem, (2, 4)), "problem"),
    Hostile("problem of meshes None", lambda: am.Hierarchy.from_meshes(None, []), "problem"),
    Hostile("problem of graded None", lambda: am.Hierarchy.graded(None, (0.01,)), "problem"),
    Hostile("problem of bisected None", lambda: am.Hierarchy.bisected(None, _grids()[0].mesh, 1), "problem"),
    Hostile("points of SizeNear", lambda: am.SizeNear(5.0, size=0.1), "points"),
    Hostile("sizes text", lambda: am.Hierarchy.graded(am.cases.greco_bar(), "0.01"), "sizes"),
    Hostile("sizes of text", lambda: am.Hierarchy.graded(am.cases.greco_bar(), ("0.01",)), "size"),
    Hostile("sizes True", lambda: am.Hierarchy.graded(am.cases.greco_bar(), (True,)), "size"),
    Hostile("sizes None", lambda: am.Hierarchy.graded(am.cases.greco_bar(), None), "sizes"),
    Hostile("sizes complex", lambda: am.Hierarchy.graded(am.cases.greco_bar(), (0.01j,)), "size"),
    Hostile("sizes empty", lambda: am.Hierarchy.graded(am.cases.greco_bar(), ()), "sizes"),
    Hostile("contact_ratio text", lambda: am.Hierarchy.graded(am.cases.greco_bar(), (0.02,), contact_ratio="2"),
            "contact_ratio"),
    Hostile("contact_rows text", lambda: am.Hierarchy.from_meshes(
        am.cases.greco_bar(), [_grids()[0].mesh, _grids()[1].mesh], contact_rows="no"), "contact_rows"),
    Hostile("levels of bisected float", lambda: am.Hierarchy.bisected(
        am.cases.greco_bar(), _grids()[0].mesh, 1.0), "levels"),
    Hostile("meshes None", lambda: am.Hierarchy.from_meshes(am.cases.greco_bar(), None), "meshes"),
    Hostile("meshes number", lambda: am.Hierarchy.from_meshes(am.cases.greco_bar(), 5), "meshes"),
    Hostile("meshes of numbers", lambda: am.Hierarchy.from_meshes(am.cases.greco_bar(), [5]), "mesh"),
    Hostile("meshes class", lambda: am.Hierarchy.from_meshes(am.cases.greco_bar(), [am.MeshArrays]), "mesh"),
    Hostile("levels None", lambda: am.Hierarchy(levels=None), "levels"),
    Hostile("levels numbers", lambda: am.Hierarchy(levels=(1, 2)), "levels[0]"),
    Hostile("levels text", lambda: am.Hierarchy(levels="ab"), "levels"),
    Hostile("levels class", lambda: am.Hierarchy(levels=(am.Level,)), "levels[0]"),
    Hostile("levels of problems", lambda: am.Hierarchy(levels=(_grids()[0].discrete,)), "levels[0]"),
    Hostile("level of nothing", lambda: am.Level(None), "discrete"),
    Hostile("level of a matrix", lambda: am.Level(sparse.eye_array(4)), "discrete"),
    Hostile("level galerkin dense", lambda: am.Level(None, galerkin=np.eye(4)), "galerkin"),
    Hostile("level galerkin csr", lambda: am.Level(None, galerkin=sparse.eye_array(4).tocsr()), "galerkin"),
    Hostile("level mesh text", lambda: _level(mesh="mesh.vol"), "mesh"),
    Hostile("level prolongation dense", lambda: _level(prolongation=np.ones((25, 9))), "prolongation"),
    Hostile("level prolongation broken", lambda: _level(prolongation=_broken(_grids()[1].prolongation)),
            "prolongation"),
    Hostile("level prolongation complex", lambda: _level(prolongation=1j * _grids()[1].prolongation), "prolongation"),
    Hostile("level surface broken", lambda: _level(surface_prolongation=_broken(_grids()[1].prolongation)),
            "surface_prolongation"),
    Hostile("level prolongation missing", lambda: _levels(prolongation=None), "levels[1].prolongation"),
    Hostile("level prolongation short", lambda: _levels(prolongation=_grids()[1].prolongation[:-1]),
            "levels[1].prolongation"),
    Hostile("level surface short", lambda: _levels(surface_prolongation=_grids()[1].prolongation[:-1]),
            "levels[1].surface_prolongation"),
    Hostile("problem of a hierarchy text", lambda: am.Hierarchy(levels=_grids().levels, problem="bar"), "problem"),
    Hostile("truncated text", lambda: _grids().truncated(coarsest="0"), "coarsest"),
    Hostile("truncated beyond", lambda: _grids().truncated(finest=5), "finest"),
)
