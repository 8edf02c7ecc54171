"""Errors and residuals with prescribed displacements: of deformation and forces, not of a nodal jump."""

from dataclasses import replace

import numpy as np
import pytest
from norms import distance

import adaptmg as am
from adaptmg.smoother.system import local_system
from adaptmg.solver.examine import Sizes

DOWN, GAP = 10e-3, 9.99e-3
STEEL = am.PlaneStrain(young=1.3e11, poisson=0.2)


def lowered(down=DOWN):
    """A block lowered through a gap until it is pressed by 10 micrometres."""
    return am.ContactProblem(
        name="lowered", domain=am.Rectangle(width=40e-3, height=40e-3), material=STEEL, law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.GapFunction(lambda points: np.full(len(points), GAP))),
        supports=(am.Support("top", x=0.0, y=-down),))


def lowered_on_a_block():
    lower = am.Rectangle(width=60e-3, height=30e-3, origin=(-10e-3, -30e-3 - GAP))
    return replace(
        lowered(), domain=am.Assembly(parts={"upper": lowered().domain, "lower": lower}),
        contact=am.ContactPair("upper.bottom", "lower.top", reach=2 * GAP),
        supports=(am.Support("upper.top", x=0.0, y=-DOWN), am.Support("lower.bottom", x=0.0, y=0.0)))


METHODS = {"truncated, nested": am.FullMultigrid(), "truncated, from zero": am.Multigrid(),
           "monotone, nested": am.FullMultigrid(correction=am.Monotone()),
           "monotone, from zero": am.Multigrid(correction=am.Monotone()), "single grid": am.SingleGrid(omega=1.9),
           "single grid, condensed": am.SingleGrid(condensed=True), "active set": am.ActiveSet(),
           "active set, AMG": am.ActiveSet(linear=am.AMG())}


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
    local = local_system(discrete)
    u = np.where(discrete.fixed, discrete.fixed_values,
                 1e-3 * np.random.default_rng(0).standard_normal(discrete.n_dofs))
    eliminated = u - discrete.fixed_values
    w, sizes = local.to_local(u) if frames else eliminated, Sizes(discrete, local.frames if frames else None)
    energy = eliminated @ (discrete.matrix @ eliminated)
    assert sizes.norm(w, energy) == pytest.approx(np.sqrt(u @ (discrete.matrix @ u)), rel=1e-9)
    reactions = (discrete.matrix @ u - discrete.load)[discrete.fixed]
    assert sizes.forces(w, 0.0) == pytest.approx(np.linalg.norm(reactions), rel=1e-12)
    assert sizes.forces(w, 1e20) == 1e20


def test_between_bodies():
    grids = am.Hierarchy.uniform(lowered_on_a_block(), [{"upper": k, "lower": (3 * k // 2, 3 * k // 4)}
                                                        for k in (4, 8, 16)])
    exact = am.solve(grids, am.ActiveSet(rtol=3e-11))
    for method in ("truncated, nested", "monotone, nested", "active set"):
        for rtol in (1e-3, 1e-8):
            result = am.solve(grids, replace(METHODS[method], rtol=rtol), reference=exact)
            assert result.history["true_error"][-1] <= 3 * rtol, (method, rtol)


def test_load_steps(grids, exact):
    """Half way down nothing touches; then the block is pressed."""
    apart, pressed = am.solve_path(grids, am.LoadPath({"top": [0.5, 1.0]}), am.FullMultigrid(rtol=1e-8))
    assert (apart.contact.state == am.OPEN).all()
    assert distance(grids.finest.discrete, pressed.displacement, exact.displacement) <= 3e-8


def test_a_body_that_nothing_strains():
    """Lowered half way, all its forces are rounding, to which nothing can be related."""
    apart = am.Hierarchy.uniform(lowered(down=5e-3), divisions=(4, 8, 16))
    for method in ("truncated, nested", "monotone, nested", "active set"):
        result = am.solve(apart, replace(METHODS[method], rtol=1e-8))
        assert np.abs(result.displacement - [0.0, -5e-3]).max() <= 1e-14, method
