"""What users write, for pyright (``[tool.pyright]``): lists and tuples where arrays are taken. It
is not run."""
# pyright: reportUnnecessaryTypeIgnoreComment=true

from __future__ import annotations

import numpy as np
from scipy import sparse

import adaptmg as am


class Relaxation:
    """A method of the user, with a class of the package as the type of each argument."""

    def setup(self, hierarchy: am.Hierarchy, start: am.State) -> Relaxation:
        return self

    def step(self, state: am.State) -> am.State:
        return state


def posed() -> am.ContactProblem:
    """A block on a plane."""
    return am.ContactProblem(
        domain=am.Rectangle(width=1, height=1),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        law=am.Coulomb(lambda x: 0.3 + 0 * x[:, 0]),
        loads=(am.Pressure("top", lambda x: 1e6 * x[:, 0]), am.BodyForce((0, -1))),
        supports=(am.Support("left", x=0),),
    )


def solve() -> float:
    """Solvers, their results, and matrices of the user."""
    grids = am.Hierarchy.graded(posed(), sizes=(0.5, 0.3), contact_ratio=2, transfer=am.PseudoL2())
    for solver in (
        am.Multigrid(correction=am.Monotone(), smoother=am.ProjectedGaussSeidel(omega=1.2)),
        am.Multigrid(correction=am.PaperCorrection()),
        am.ActiveSet(linear=am.AMG()),
        am.SingleGrid(),
        Relaxation(),
    ):
        result = am.solve(grids, solver, throw=False)
        am.plot.history({"a": result}, against="cycle").savefig("history.png", dpi=100)
        print(result.status.name, result.history["residual"][-1], result.certificate().energy_error)
    result = am.solve(grids, am.FullMultigrid(rtol=1e-6))
    mesh = am.mesh.need_mesh(result)
    moved = result.displacement[mesh.boundary_nodes("left")] + result.resultant("left").force
    print(
        grids.finest.discrete.matrix.nnz,
        grids[1].prolongation.nnz,
        result.probe([(0.1, 0.2)]),
        moved,
    )
    contact = am.ContactNodes(nodes=[0], normals=[[0.0, -1.0]], gaps=[0.0])
    discrete = am.DiscreteProblem(
        matrix=sparse.eye_array(2),
        load=[0.1, -1.0],
        fixed=[False, False],
        law=am.Tresca([1.0]),
        contact=contact,
    )
    print(am.solve(discrete, start=np.zeros((1, 2))).cycles)
    steps = am.solve_path(grids, am.LoadPath({"top": [0.5, 1.0]}))
    am.plot.load_history(list(steps), [0.5, 1.0], {"p": lambda step: step.contact.pressure.max()})
    return max(float(step.contact.slip.max()) for step in steps)


def adapt() -> float:
    """Meshes, estimates, loops and studies."""
    mesh = am.MeshArrays(
        [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], [[0, 1], [1, 2], [2, 0]], [0, 1, 1], ("foot", "rest")
    )
    print(mesh.n_nodes, am.Estimate(squares=[1.0], norm=2).total)
    goal = am.Goal(am.ContactForce("contact"))
    for step in am.adapt(
        posed(), 0.5, indicator=goal, mark=am.Maximum(0.5), engine=am.Bisect(), max_nodes=100
    ):
        am.plot.deformation(step.result, stress=True, states=True)
    table = am.Study(lambda n: {"square": n * n}, {"n": [1, 2]}).run(workers=2)
    return float(table.query("n > 1")["square"].max())


def mistaken() -> None:
    """What pyright must find: an ignored error that it does not see is an error."""
    problem = posed()
    solver = am.FullMultigrid(rtoll=1e-8)  # pyright: ignore[reportCallIssue]
    result = am.solve(am.Hierarchy.uniform(problem, divisions=(4, 8)), solver)
    print(result.contact.presure)  # pyright: ignore[reportAttributeAccessIssue]
    am.plot.contact(problem)  # pyright: ignore[reportArgumentType]
    am.plot.contcat(result)  # pyright: ignore[reportAttributeAccessIssue]
    am.export.vtkk(result, "run.vtu")  # pyright: ignore[reportAttributeAccessIssue]
    am.study.Sobl({"sweeps": [1, 2]})  # pyright: ignore[reportAttributeAccessIssue]
    am.mesh.gradde(problem.domain, 1e-3)  # pyright: ignore[reportAttributeAccessIssue]
