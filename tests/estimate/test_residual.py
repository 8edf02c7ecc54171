"""The residual indicator: zero where the solution is exact; terms, norms, tractions that it is made
of; its values."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from made import cube, result_on, square

import adaptmg as am
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.stress import StressData
from adaptmg.estimate import stress_fields
from adaptmg.estimate.estimate import condition_squares
from adaptmg.estimate.stress_fields import Solved, neighbours

EXACT = am.FullMultigrid(rtol=1e-10)


def made(mesh: am.MeshArrays) -> Solved:
    """Made-up contact on 'bottom' of a square or cube."""
    dim, kind = mesh.dim, am.PlaneStrain if mesh.dim == 2 else am.Solid
    problem = am.ContactProblem(
        material=kind(young=1e11, poisson=0.2),
        law=am.Coulomb(1.0),
        contact=am.Contact("bottom", am.Plane((0.0,) * dim, tuple(np.eye(dim)[dim - 1]))),
    )
    result = result_on(mesh, stress_data=StressData.of(mesh, problem.material))
    return Solved(Posed(problem, mesh), SimpleNamespace(law=problem.law), result)


@pytest.mark.parametrize("mesh", [square(6), cube(3)], ids=["2D", "3D"])
def test_what_a_solver_leaves_is_not_an_error_of_the_mesh(mesh):
    this = made(mesh)
    c = this.result.contact
    opens, slides = c.state == am.OPEN, (c.state == am.SLIP)[:, None]
    left = dataclasses.replace(
        c,
        force_n=c.force_n + 1e2 * opens,
        limit=c.limit + 1e2 * opens,
        gap=c.gap - 1e-9 * ~opens,
        force_t=np.where(slides | opens[:, None], c.force_t + 1e2, c.force_t),
    )
    loose = dataclasses.replace(this, result=dataclasses.replace(this.result, contact=left))
    for exact, found in zip(condition_squares(this), condition_squares(loose), strict=True):
        assert exact.max() > 0 and exact.min() >= 0
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-14 * exact.max())


@pytest.mark.parametrize(
    "options", [None, {"slope": 20.0, "side_pressure": 3e7}, {"dim": 3}], ids=str
)
def test_exact_solutions_have_no_error_and_equal_tractions(options):
    if options is None:
        problem = am.cases.greco_bar(law=am.Frictionless())
        grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    else:
        problem = am.cases.two_block_patch(**options)
        grids = am.Hierarchy.graded(problem, (0.05, 0.03))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-11))
    for indicator in (am.Residual(), am.Recovery()):
        assert indicator.indicate(grids, result).relative < 1e-7
    if options is not None:
        sides = stress_fields.contact_tractions(result.mesh, result, False)
        slave, master = (sides[name].values for name in problem.pair_boundaries)
        size = np.hypot(problem.reference["pressure"], problem.reference["traction"])
        for values in (slave, master):
            np.testing.assert_allclose(np.linalg.norm(values, axis=1), size, rtol=1e-7)
        np.testing.assert_allclose(slave.mean(axis=0), -master.mean(axis=0), rtol=1e-7, atol=1.0)


@pytest.fixture(scope="module")
def solved():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    return grids, am.solve(grids, EXACT)


def test_terms_sum_to_the_total_and_the_norm_is_of_displacements(solved, tmp_path):
    grids, result = solved
    result.save(tmp_path / "r.npz")
    for indicator in (am.Residual(), am.Recovery()):
        estimate = indicator.indicate(grids, result)
        assert sum(estimate.terms.values()) == pytest.approx(estimate.total**2, rel=1e-12)
        u = result.displacement.reshape(-1)
        assert estimate.norm == pytest.approx(
            np.sqrt(u @ (grids.finest.discrete.matrix @ u)), rel=1e-12
        )
        assert estimate.squares.shape == (len(result.mesh.elements),)
        again = indicator.indicate(grids, am.Result.load(tmp_path / "r.npz"))
        np.testing.assert_array_equal(again.squares, estimate.squares)
    broken = dataclasses.replace(result.contact, force_n=np.full(len(result.contact), np.nan))
    with pytest.raises(ValueError, match="squares must be finite"):
        am.Residual().indicate(grids, dataclasses.replace(result, contact=broken))


def test_a_contact_boundary_cut_in_two_bears_what_it_bears_whole():
    whole, size, floor = am.cases.greco_bar(), 40e-3, am.Plane((0, 0), (0, 1))
    cut = am.Polygon(
        vertices=((0, 0), (size / 2, 0), (size, 0), (size, size), (0, size)),
        boundaries=("first", "second", "right", "top", "left"),
    )
    mesh = am.mesh.graded(cut, 4e-3, ("first", "second"), 1.0)
    joined = dataclasses.replace(
        mesh,
        facet_labels=np.where(mesh.facet_labels == 1, 0, mesh.facet_labels),
        boundaries=("bottom", "unused", "right", "top", "left"),
    )
    two = dataclasses.replace(
        whole,
        domain=cut,
        reference={},
        contact=(am.Contact("first", floor), am.Contact("second", floor)),
    )
    estimates, displacements = [], []
    for problem, used in ((two, mesh), (dataclasses.replace(whole, domain=None), joined)):
        grids = am.Hierarchy.from_meshes(problem, [used])
        result = am.solve(grids, am.ActiveSet(rtol=1e-11))
        displacements.append(result.displacement)
        estimates.append(am.Residual().indicate(grids, result).squares)
    np.testing.assert_allclose(*displacements, atol=1e-9 * np.abs(displacements[1]).max())
    # next to the cut the pressure is constant over an edge
    assert estimates[0].sum() == pytest.approx(estimates[1].sum(), rel=0.02)
    centres = mesh.points[mesh.elements].mean(axis=1)
    far = np.linalg.norm(centres - (size / 2, 0), axis=1) > 8e-3
    np.testing.assert_allclose(*(one[far] for one in estimates), rtol=1e-6, atol=1e-15)


def test_a_facet_of_no_element_is_refused():
    mesh = square(2)
    wrong = dataclasses.replace(mesh, facets=np.vstack([mesh.facets[:-1], [[0, 8]]]))
    with pytest.raises(
        ValueError, match=r"boundary facet 7 of nodes \[0, 8\] belongs to no element"
    ):
        neighbours(wrong)


def bar():
    problem = am.cases.greco_bar()
    return am.ContactProblem(
        material=am.PlaneStress(young=1.3e11, poisson=0.2),
        domain=problem.domain,
        contact=am.Contact("bottom", am.GapFunction(lambda x: 1e-6 * np.cos(90 * x[:, 0]) + 1e-6)),
        law=am.Coulomb(lambda x: 0.2 + 10 * x[:, 0]),
        supports=problem.supports,
        loads=(
            am.Pressure("top", lambda x: 5e7 + 1e9 * x[:, 0]),
            am.BodyForce((3e8, -2e8)),
            am.Traction("left", (1e8, -1e7)),
            am.InitialStrain("body", (2e-4, -1e-4, 3e-4)),
        ),
    )


def glued(kind):
    """Two materials that share the nodes where they meet."""
    solid = kind is am.Solid
    problem = (
        am.cases.greco_block(law=am.Coulomb(0.5), plane_strain=False)
        if solid
        else am.cases.greco_bar()
    )
    mesh = am.mesh.structured(problem.domain, 2 if solid else 3)
    away = 0.02 * (kind is am.Axisymmetric) * np.eye(mesh.dim)[0]
    mesh = dataclasses.replace(
        mesh,
        points=mesh.points + away,
        bodies=("a", "b"),
        element_body=np.array(mesh.points[mesh.elements, 0].mean(axis=1) > 0.02, dtype=np.int32),
    )
    material = {"a": kind(young=2e11, poisson=0.3), "b": kind(young=7e10, poisson=0.1)}
    loads = (*problem.loads, am.InitialStrain("b", (1e-4, -2e-4, 3e-4)))
    problem = dataclasses.replace(
        problem, material=material, domain=None, loads=loads, reference={}
    )
    return am.Hierarchy.from_meshes(problem, [mesh])


def blocks(kind=am.PlaneStrain, upper=None):
    parts = {
        "a": am.Rectangle(
            width=0.04, height=0.03, origin=(0.01 if kind is am.Axisymmetric else 0.0, 0.0)
        ),
        "b": am.Rectangle(width=0.06, height=0.03, origin=(0.005, -0.03)),
    }
    return am.ContactProblem(
        material={"a": upper or kind(young=1e11, poisson=0.3), "b": kind(young=2e11, poisson=0.2)},
        domain=am.Assembly(parts=parts),
        contact=am.ContactPair("a.bottom", "b.top"),
        law=am.Coulomb(0.4),
        loads=(
            am.Traction("a.top", (2e7, -6e7)),
            am.BodyForce((0.0, -1e8), body="b"),
            am.InitialStrain("a", (1e-4, 5e-5, 2e-4)),
        ),
        supports=(
            am.Support("b.bottom", y=0.0),
            am.Support("b.left", x=0.0),
            am.Support("a.left", x=1e-6),
        ),
    )


PAIR = {"a": (3, 2), "b": (4, 2)}
ORTHOTROPIC = am.Axisymmetric.orthotropic(
    young=(2e11, 5e10, 1e11), poisson=(0.3, 0.2, 0.1), shear=(4e10, 6e10, 5e10), angle=30.0
)
#: problem, divisions (or a hierarchy), and what the formula gave element by element in plain Python: the terms (element
#: residual, jumps, boundaries, contact, complementarity, friction), and the sum of squares times (1 + e) / n
CASES = {
    "plane stress, obstacle": (
        bar,
        3,
        (0.56888889, 7.4814626, 0.33809923, 1.2831716, 0, 0.0757122),
        3.7519165,
    ),
    "pair": (blocks, PAIR, (0.0405, 54.498596, 3.8069607, 4.2219591, 0, 0.070933649), 21.896368),
    "axisymmetric pair": (
        lambda: blocks(am.Axisymmetric),
        PAIR,
        (2.9757006, 7.6940501, 0.83375572, 1.0197859, 0, 0.009574504),
        4.1924137,
    ),
    "orthotropic pair": (
        lambda: blocks(am.Axisymmetric, ORTHOTROPIC),
        PAIR,
        (2.2882413, 4.2364144, 0.35873172, 0.40873762, 0, 0.0042996869),
        2.8050546,
    ),
    "Tresca": (
        lambda: am.cases.greco_bar(law=am.Tresca(3e7)),
        4,
        (7.6553872, 0.36174063, 1.0401143, 0.05572818, 0.20610464),
        3.0333435,
    ),
    "glued, axisymmetric": (
        lambda: glued(am.Axisymmetric),
        None,
        (15.945713, 14.414854, 2.9730201, 2.1875566, 0.03478931, 0.057863849),
        17.950514,
    ),
    "glued solids": (
        lambda: glued(am.Solid),
        None,
        (0.7822859, 0.092096826, 0.24206155, 0, 0.093927186),
        0.43896998,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_indicator_is_its_formula(name):
    make, divisions, terms, moment = CASES[name]
    hierarchy = make() if divisions is None else am.Hierarchy.uniform(make(), (divisions,))
    result = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    assert len(np.unique(result.contact.state)) > 1
    estimate = am.Residual().indicate(hierarchy, result)
    assert list(estimate.terms.values()) == pytest.approx(terms, rel=1e-6, abs=1e-12)
    n = len(estimate.squares)
    assert estimate.squares @ (1 + np.arange(n)) / n == pytest.approx(moment, rel=1e-6)
