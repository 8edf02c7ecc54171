"""The dovetail joint: its geometry, the balance of forces, its reference values, and refused
arguments."""

from functools import cache

import numpy as np
import pytest
from refused import refused

import adaptmg as am

SIZES = (6e-3, 3.6e-3, 2.2e-3, 1.3e-3)
PULL = 100e6 * 12e-3  # N/m on the modelled half
CLAMP = 120e6 * 40e-3


def grids_of(problem: am.ContactProblem, sizes=SIZES) -> am.Hierarchy:
    return am.Hierarchy.graded(problem, sizes=sizes, contact_ratio=4)


def lift(result: am.Result) -> float:
    return float(result.probe([(0.0, 24e-3)])[0, 1])


@cache
def grids():
    return grids_of(am.cases.dovetail())


@cache
def solved():
    return am.solve(grids(), am.FullMultigrid(rtol=1e-10))


@pytest.mark.parametrize("angle", [42.0, 50.0, 89.0])
def test_flank_and_floor_touch(angle):
    contact = grids_of(am.cases.dovetail(angle=angle), SIZES[:1]).finest.discrete.contact
    assert contact.gaps == pytest.approx(0.0, abs=1e-15) and len(np.unique(contact.boundary)) == 2


def test_only_the_default_case_has_reference_values():
    reference = am.cases.dovetail().reference
    assert reference["values"]
    for other in (
        {"law": am.Coulomb(0.3)},
        {"law": am.Frictionless()},
        {"angle": 51},
        {"pull": 1e6},
        {"law": am.Coulomb(lambda x: np.full(len(x), 0.2))},
    ):
        assert set(am.cases.dovetail(**other).reference) == {"remark"}
    ends = np.array(
        sorted(limits for ranges in reference["zones"].values() for limits in ranges)
    ).ravel()
    np.testing.assert_allclose(ends[[0, -1]], [0, 13e-3])
    np.testing.assert_array_equal(ends[1:-1:2], ends[2::2])


def test_contact_carries_the_pull_and_supports_the_clamp():
    result = solved()
    assert result.cycles <= 16 and not result.certificate().contradictions(1e-8)
    for boundary in ("contact", "block.bottom", "tongue.flank"):  # the floor opens
        assert result.resultant(boundary).force[1] == pytest.approx(-PULL, rel=1e-9)
    assert result.reaction[:, 0].sum() == pytest.approx(CLAMP, rel=1e-9)
    tongue = np.unique(
        result.mesh.elements[result.mesh.element_body == result.mesh.bodies.index("tongue")]
    )
    assert abs(result.reaction[tongue, 0].sum()) < 1e-9 * PULL
    for pair in (("tongue.flank", "block.flank"), ("tongue.bottom", "block.floor")):
        slave, master = (result.resultant(name) for name in pair)
        assert np.abs(slave.force + master.force).max() <= 1e-12 * PULL
        # where the gap is closed both also act along the same line
        assert abs(slave.moment + master.moment) <= 1e-12 * PULL


def test_lift_and_zones_converge_to_the_reference():
    reference, result = am.cases.dovetail().reference, solved()
    exact = reference["values"]["converged"]["axis"]
    errors = [
        exact - lift(am.solve(grids().truncated(finest=2), am.FullMultigrid())),
        exact - lift(result),
    ]
    # uniform refinement at singular corners: the error about halves
    assert 0 < errors[1] < 0.75 * errors[0] and errors[1] < 0.02 * exact
    c = result.contact
    flank = np.flatnonzero(c.boundary == c.names.index("tongue.flank"))
    flank = flank[np.argsort(-c.x[flank, 1])]
    depth, state = -c.x[flank, 1], c.state[flank]
    ends = np.flatnonzero(np.diff(state))
    assert [int(s) for s in state[np.r_[ends, -1]]] == [am.OPEN, am.SLIP, am.STICK, am.SLIP]
    zones = reference["zones"]
    for k, end in zip(ends, [zones["open"][0][1], *zones["stick"][0]], strict=True):
        h = depth[k + 1] - depth[k]
        assert depth[k] - h <= end <= depth[k + 1] + h
    assert (c.state[c.boundary == c.names.index("tongue.bottom")] == am.OPEN).all()


test_refused = refused(
    *(
        (lambda options=options: am.cases.dovetail(**options), message)
        for options, message in (
            ({"angle": 90.0}, "angle must be at least 41.6 degrees .* below 90, got 90.0"),
            ({"angle": 30}, "angle must be at least 41.6 degrees .* got 30"),
        )
    )
)
