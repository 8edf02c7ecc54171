"""Errors are what methods claim: of deformation and forces, not of a nodal jump."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from norms import distance
from scipy.sparse.linalg import splu
from study_scripts import load

import adaptmg as am
from adaptmg.solver.examine import Sizes, displacement_norm

DOWN, GAP = 10e-3, 9.99e-3
slender = load("slender_bodies")
STEEL = am.PlaneStrain(young=1.3e11, poisson=0.2)


def lowered(down=DOWN):
    """A block lowered through a gap until it is pressed by 10 micrometres."""
    return am.ContactProblem(
        name="lowered",
        domain=am.Rectangle(width=40e-3, height=40e-3),
        material=STEEL,
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.GapFunction(lambda points: np.full(len(points), GAP))),
        supports=(am.Support("top", x=0.0, y=-down),),
    )


METHODS = {
    "truncated, nested": am.FullMultigrid(),
    "truncated, from zero": am.Multigrid(),
    "monotone, nested": am.FullMultigrid(correction=am.Monotone()),
    "monotone, from zero": am.Multigrid(correction=am.Monotone()),
    "single grid": am.SingleGrid(omega=1.9),
    "single grid, condensed": am.SingleGrid(condensed=True),
    "active set": am.ActiveSet(),
    "active set, AMG": am.ActiveSet(linear=am.AMG()),
}


@pytest.fixture(scope="module")
def grids():
    return am.Hierarchy.uniform(lowered(), divisions=(4, 8, 16))


@pytest.fixture(scope="module")
def exact(grids):
    # rounding of 10 mm is 1e-11 of the 10 micrometres that deform the block
    return am.solve(grids, am.ActiveSet(rtol=3e-11))


@pytest.mark.parametrize("method", list(METHODS))
def test_the_error_is_what_was_asked_for(grids, exact, method):
    for rtol in (1e-3, 1e-8):
        result = am.solve(grids, replace(METHODS[method], rtol=rtol), reference=exact)
        true = distance(grids.finest.discrete, result.displacement, exact.displacement)
        assert true <= 3 * rtol
        if method != "single grid, condensed":  # its interior is recovered after the last check
            assert result.history["true_error"][-1] == pytest.approx(true, rel=1e-2, abs=1e-11)


@pytest.mark.parametrize("frames", [False, True])
def test_sizes_against_the_matrix(grids, frames):
    """From unknowns that count from the prescribed values, in Cartesian and local components."""
    discrete = grids.finest.discrete
    local = am.smoother.local_system(discrete)
    u = np.where(
        discrete.fixed,
        discrete.fixed_values,
        1e-3 * np.random.default_rng(0).standard_normal(discrete.n_dofs),
    )
    eliminated = u - discrete.fixed_values
    w, sizes = (
        local.to_local(u) if frames else eliminated,
        Sizes(discrete, local.frames if frames else None),
    )
    energy = eliminated @ (discrete.matrix @ eliminated)
    assert sizes.norm(w, energy) == pytest.approx(np.sqrt(u @ (discrete.matrix @ u)), rel=1e-9)
    reactions = (discrete.matrix @ u - discrete.load)[discrete.fixed]
    assert sizes.forces(w, 0.0) == pytest.approx(np.linalg.norm(reactions), rel=1e-12)
    assert sizes.forces(w, 1e20) == 1e20


def heated(kind):
    """A block that expands a hundred to a thousand times more than the pressure on it compresses
    it."""
    solid = kind is am.Solid
    heat = (am.InitialStrain("body", (value,) * 3) for value in (8e-4, 2e-4))
    problem = am.ContactProblem(
        domain=am.Box(width=0.04, depth=0.04, height=0.04)
        if solid
        else am.Rectangle(width=0.04, height=0.04),
        material=kind(young=2e11, poisson=0.3),
        law=am.Coulomb(0.3),
        loads=(am.Pressure("top", 1e6), *heat),
        contact=am.Contact(
            "bottom", am.Plane((0.0, 0.0, 0.0)[not solid :], (0.0, 0.0, 1.0)[not solid :])
        ),
        supports=(am.Support("left", x=0.0), *([am.Support("front", y=0.0)] if solid else [])),
    )
    return am.Hierarchy.uniform(problem, (2, 4) if solid else (4, 8, 16))


@pytest.mark.parametrize("kind", [am.Solid, am.PlaneStrain, am.PlaneStress, am.Axisymmetric])
def test_expansion_that_meets_no_resistance_does_not_count(kind):
    grids = heated(kind)
    exact = am.solve(grids, am.ActiveSet(rtol=1e-11))
    stresses = displacement_norm(
        grids.finest.discrete, grids.finest.discrete.relative(exact.displacement)
    )
    if (
        kind is not am.PlaneStrain
    ):  # where the strain through the thickness is suppressed, and counts for the energy
        assert stresses**2 == pytest.approx(2 * exact.energy, rel=1e-4)
    for solver in (
        am.Multigrid(rtol=0.2),
        am.SingleGrid(rtol=0.1, omega=1.7),
        am.SingleGrid(rtol=0.1, condensed=True),
    ):
        result = am.solve(grids, solver)
        assert (
            distance(grids.finest.discrete, result.displacement, exact.displacement) <= solver.rtol
        )
        assert result.contact.force_n.sum() == pytest.approx(
            exact.contact.force_n.sum(), rel=2 * solver.rtol
        )


def test_load_steps(grids, exact):
    """Half way down nothing touches; then the block is pressed."""
    apart, pressed = am.solve_path(
        grids, am.LoadPath({"top": [0.5, 1.0]}), am.FullMultigrid(rtol=1e-8)
    )
    assert (apart.contact.state == am.OPEN).all()
    assert distance(grids.finest.discrete, pressed.displacement, exact.displacement) <= 3e-8


@pytest.mark.parametrize("load", [0.0, 3e-2, 7e9])
def test_a_body_that_nothing_strains(load):
    """Lowered half way, all its forces are rounding but those of loads on the face that is held,
    to which nothing can be related."""
    on_the_support = (am.Pressure("top", load), am.Traction("top", (-2 * load, load)))
    problem = replace(lowered(down=5e-3), loads=on_the_support if load else ())
    apart = am.Hierarchy.uniform(problem, divisions=(4, 8, 16))
    for method in METHODS:
        result = am.solve(apart, replace(METHODS[method], rtol=1e-8))
        assert np.abs(result.displacement - [0.0, -5e-3]).max() <= 1e-13, method
        assert not result.certificate().contradictions(1e-8)
        held = result.resultant("top").force
        np.testing.assert_allclose(held, 40e-3 * load * np.array([2, 0]), atol=1e-3 + 1e-6 * load)


@cache
def folded():
    """A serpentine of eight arms, 40 : 1, on a plane, its top pressed down and moved aside; and its
    solution."""
    meshes = [
        slender.cut_out(slender.spring(8, 40), 1e-3, divisions, (0.0, 0.0)) for divisions in (1, 2)
    ]
    grids = am.Hierarchy.from_meshes(
        am.ContactProblem(
            name="spring",
            material=am.PlaneStrain(young=2.1e11, poisson=0.3),
            law=am.Coulomb(0.3),
            contact=am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1))),
            supports=(am.Support("top", x=5e-5, y=-2e-4),),
        ),
        meshes,
    )
    return grids, am.solve(grids, am.ActiveSet(rtol=1e-6)).displacement


@pytest.mark.parametrize(
    "solver",
    [
        am.FullMultigrid(rtol=0.1),
        am.FullMultigrid(rtol=1e-3),
        am.FullMultigrid(correction=am.Monotone(), rtol=0.1),
    ],
    ids=["nested", "nested, closer", "monotone"],
)
def test_on_a_folded_body(solver):
    grids, exact = folded()
    result = am.solve(grids, solver)
    true = distance(grids.finest.discrete, result.displacement, exact)
    assert true <= 3 * solver.rtol
    assert 0.5 * true <= result.certificate().energy_error <= 1.5 * true


@cache
def bent():
    """A slender body, and its solution."""
    grids = slender.random_slender(71012)
    return grids, am.solve(grids, am.ActiveSet(rtol=1e-10)).displacement


@pytest.mark.parametrize(
    "solver",
    [
        am.FullMultigrid(rtol=1e-5),
        am.Multigrid(rtol=0.1),
        am.FullMultigrid(correction=am.Monotone(), rtol=1e-2),
        am.SingleGrid(omega=1.9, rtol=0.3),
    ],
    ids=["truncated, nested", "truncated, from zero", "monotone", "single grid"],
)
def test_methods_go_on_where_only_the_certificate_sees_the_error(solver):
    """Their estimates alone would end them with 1.35, 1.72, 1.54, 3.63 times the tolerance."""
    grids, exact = bent()
    result = am.solve(grids, solver)
    assert result.status is am.Status.CONVERGED and not result.fallback
    assert distance(grids.finest.discrete, result.displacement, exact) <= solver.rtol


def test_contact_nodes_that_open_one_after_the_other():
    # Newton steps shrink while the contact zone does; the certificate, which holds the status, sees
    # a twelfth of it
    grids, exact = bent()
    result = am.solve(grids, am.ActiveSet(rtol=5.5e-3))
    assert distance(grids.finest.discrete, result.displacement, exact) <= 3 * 5.5e-3


def refined(discrete, result):
    """The displacement (n_dofs,) with the contact status of a frictionless result whose normals
    are vertical; its residual is summed in extended precision."""
    matrix, held, at = discrete.matrix.tocsr(), discrete.fixed.copy(), discrete.contact.nodes
    exact = np.zeros(len(held), dtype=np.longdouble)
    touching = 2 * at[result.contact.closed] + 1
    held[touching] = True
    exact[touching] = -discrete.contact.gaps[result.contact.closed]
    free = np.flatnonzero(~held)
    factors = splu(matrix[free][:, free].tocsc())
    products = matrix.data.astype(np.longdouble)
    for _ in range(8):
        sums = np.add.reduceat(products * exact[matrix.indices], matrix.indptr[:-1])
        exact[free] += factors.solve((discrete.load - sums)[free].astype(float))
    return exact.astype(float).reshape(-1, 2)


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision")
@pytest.mark.parametrize("method", ["truncated, nested", "truncated, from zero", "active set"])
def test_rounding_of_slender_bodies_widens_the_tolerance_and_is_reported(method):
    # beams of 200 : 1, in an order that sums alike nowhere
    cells = np.zeros((200, 3), dtype=bool)
    cells[:, 1] = cells[0, 2] = cells[50:, 0] = True
    for law in (am.Frictionless(), am.Coulomb(0.3)):
        problem = am.ContactProblem(
            name="beam",
            material=am.PlaneStrain(young=2e11, poisson=0.3),
            law=law,
            contact=am.Contact("bottom", am.Plane(point=(0, -2e-3), normal=(0, 1))),
            loads=(am.BodyForce((0.0, -1e6)),),
            supports=(am.Support("top", x=0.0, y=0.0),),
        )
        meshes = [slender.cut_out(cells, 1e-3, divisions, (0.0, 0.0)) for divisions in (1, 2)]
        grids = am.Hierarchy.from_meshes(problem, meshes)
        with pytest.warns(UserWarning, match="rtol=1e-12 is below what double precision reaches"):
            result = am.solve(grids, replace(METHODS[method], rtol=1e-12))
        assert 1e-10 < result.rtol < 1e-6 and result.cycles <= 60
        if isinstance(law, am.Frictionless):
            discrete = grids.finest.discrete
            exact = refined(discrete, result)
            assert distance(discrete, result.displacement, exact) <= result.rtol


def test_a_patch_test_to_the_discretisation_error():
    # the nested start is exact: no cycle shows a discretisation error, whose tenth would be the
    # tolerance
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Frictionless()), divisions=(2, 4, 8))
    result = am.solve(grids, am.FullMultigrid(rtol="discretisation"))
    assert result.status.ok and result.cycles == 0 and result.residual < 1e-13


@pytest.mark.parametrize("start", [am.FullMultigrid, am.Multigrid])
@pytest.mark.parametrize("seed", range(2))
def test_gaps_of_thousands_of_displacements_do_not_stall(seed, start):
    certificate = am.solve(slender.random_gaps(seed), start(rtol=1e-8)).certificate()
    # the product of rounding and the whole gap, over the work of contact, is 2e-8 to 1e-7
    assert certificate["complementarity"].relative <= 1e-8 and not certificate.contradictions(1e-8)


@cache
def bars(case, friction):
    if case == "block":
        return am.Hierarchy.uniform(am.cases.greco_block(law=am.Coulomb(friction)), (2, 4, 8))
    return am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), (4, 8, 16, 32))


@cache
def exactly(case, friction):
    return am.solve(bars(case, friction), am.ActiveSet(rtol=1e-13))


@pytest.mark.parametrize(
    ("case", "friction", "rtol"),
    [
        ("bar", 0.1, 1e-6),
        ("bar", 1.5, 1e-6),
        ("bar", 0.6, 3e-9),
        ("block", 0.3, 1e-6),
        ("bar", 0.6, 1e-2),
    ],
)
@pytest.mark.parametrize(
    "solver",
    [
        am.FullMultigrid,
        am.ActiveSet,
        lambda rtol: am.FullMultigrid(correction=am.Monotone(), rtol=rtol),
    ],
    ids=["truncated", "active set", "monotone"],
)
def test_the_true_error_is_at_most_rtol(case, friction, rtol, solver):
    result = am.solve(bars(case, friction), solver(rtol=rtol))
    solution = exactly(case, friction).displacement
    assert distance(bars(case, friction).finest.discrete, result.displacement, solution) <= rtol
    assert result.status is am.Status.CONVERGED and result.checked.energy_error <= rtol
