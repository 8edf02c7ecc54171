"""The bolted junction: equilibrium, preload, the effect of the pressure, 2D against 3D, agreement
of methods."""

import math
from functools import cache

import numpy as np
import pytest
from refused import refused

import adaptmg as am

MM = 1e-3
SIZES = (12 * MM, 7 * MM, 4 * MM)
PRESSURES = (2e6, 4e6, 6e6, 8e6)
#: the size of forces, N
FORCE = 2.5e6


def bolt_force(result: am.Result) -> float:
    """Of all bolts around the circumference."""
    c = result.contact
    heads = [k for k, name in enumerate(c.names) if name.endswith("upper_head")]
    return (1 if result.dim == 2 else 4) * c.force_n[np.isin(c.boundary, heads)].sum()


def joint(result: am.Result) -> tuple[np.ndarray, ...]:
    """Radii, gaps, pressures and states of the joint's nodes, from the bore outwards."""
    c, mine = result.contact, result.contact.boundary == 0
    radii = np.linalg.norm(c.x[mine, : result.dim - 1], axis=1)
    return tuple(
        values[np.argsort(radii)]
        for values in (radii, c.gap[mine], c.pressure[mine], c.state[mine])
    )


def open_to(result: am.Result) -> float:
    radii, _, _, state = joint(result)
    first = int(np.argmax(state != am.OPEN))
    return radii[max(first - 1, 0) : first + 1].mean()


def filled(pressures) -> am.LoadPath:
    """Tightened, then under pressure."""
    factors = np.array([0.0, *pressures]) / 4e6
    return am.LoadPath(dict.fromkeys(("upper.bore", "lower.bore", "upper.pipe"), factors))


@cache
def grids() -> am.Hierarchy:
    return am.Hierarchy.graded(am.cases.bolted_junction(), SIZES, contact_ratio=2)


@cache
def solved() -> am.Result:
    return am.solve(grids(), am.ActiveSet(rtol=1e-12))


@cache
def path() -> am.PathResult:
    return am.solve_path(grids(), filled(PRESSURES), am.ActiveSet())


def test_forces_of_the_joint_of_pairs_and_of_the_bolt_balance():
    result, thrust = solved(), 4e6 * math.pi * 0.2**2
    assert result.resultant("upper.joint").force[1] == pytest.approx(
        bolt_force(result) - thrust, rel=1e-10
    )
    # the end of the upper pipe pulls, the support at the end of the lower one holds
    assert result.resultant("lower.pipe").force[1] == pytest.approx(
        -am.cases.Flanges().thrust(4e6), rel=1e-9
    )
    for pair in (
        ("upper.joint", "lower.joint"),
        ("bolt.upper_head", "upper.seat"),
        ("bolt.lower_head", "lower.seat"),
    ):
        slave, master = (result.resultant(name).force for name in pair)
        # radial forces of axisymmetry have no resultant, but they balance as well
        assert np.abs(slave + master).max() < 1e-12 * FORCE
    upper, lower = (result.contact.force_n[result.contact.boundary == k].sum() for k in (1, 2))
    assert upper == pytest.approx(lower, rel=1e-10)


def test_bolts_hardly_feel_pressure_until_the_joint_opens():
    results = path()
    # tightened bolts have about their preload
    assert bolt_force(results[0]) == pytest.approx(FORCE, rel=0.06)
    assert joint(results[0])[1][0] == pytest.approx(0.0, abs=1e-12) and open_to(
        results[0]
    ) == pytest.approx(0.2)
    force = np.array([bolt_force(r) for r in results])
    thrust = np.array([0.0, *(am.cases.Flanges().thrust(p) for p in PRESSURES)])
    assert (np.diff([joint(r)[1][0] for r in results]) > 0).all()
    assert (np.diff([open_to(r) for r in results]) > 0).all()
    share = np.diff(force) / np.diff(thrust)
    # closed on the bolt circle the flanges take the thrust from the joint; open, the bolts take it
    assert (np.abs(share[:2]) < 0.06).all() and share[-1] > 0.3 and (np.diff(share) > 0).all()
    seal = [
        pressure[radii <= am.cases.Flanges().inside_bolts].max()
        for radii, _, pressure, _ in map(joint, results)
    ]
    assert seal[2] > 4e6 and seal[3] < 6e6


def test_values_by_mesh_convergence():
    values, result = am.cases.bolted_junction().reference["values"], solved()
    radii, gap, pressure, state = joint(result)
    assert open_to(result) == pytest.approx(values["open_to"], abs=2 * MM)
    # between the last node that slips and the next one
    last = np.flatnonzero(state == am.SLIP)[-1]
    assert radii[last : last + 2].mean() == pytest.approx(values["slip_to"], abs=2 * MM)
    assert gap[0] == pytest.approx(values["gap"], rel=0.08)
    assert pressure.max() == pytest.approx(values["peak"], rel=0.06)
    assert result.resultant("upper.joint").force[1] == pytest.approx(
        values["joint_force"], rel=0.07
    )
    assert "values" not in am.cases.bolted_junction(pressure=3e6).reference


def test_a_sector_in_three_dimensions_agrees_with_the_ring():
    hierarchy = am.Hierarchy.graded(am.cases.bolted_junction(dim=3), (28 * MM,))
    tightened, loaded = am.solve_path(hierarchy, filled([4e6]), am.ActiveSet())
    force = [bolt_force(r) for r in (tightened, loaded)]
    # coarse meshes are too stiff, and the force of shortened bolts is too large
    assert 1.0 < force[0] / bolt_force(path()[0]) < 1.1
    thrust = 4 * loaded.resultant("lower.pipe").force[2]
    assert -thrust == pytest.approx(am.cases.Flanges().thrust(4e6), rel=0.01)
    # the pressure on a bore of chords has a small axial force too
    assert 4 * loaded.resultant("upper.joint").force[2] == pytest.approx(
        force[1] + thrust, rel=1e-3
    )
    c = loaded.contact
    lower = sum(c.force_n[c.boundary == c.names.index(f"bolt{k}.lower_head")].sum() for k in (0, 1))
    assert 4 * lower == pytest.approx(force[1], rel=1e-9)
    for slaves, master in (
        (["upper.joint"], "lower.joint"),
        (["bolt0.upper_head", "bolt1.upper_head"], "upper.face"),
    ):
        balance = sum(loaded.resultant(name).force for name in (*slaves, master))
        assert np.abs(balance).max() < 1e-12 * FORCE
    assert (
        abs(force[1] - force[0]) < 0.1 * -thrust
        and 0 < joint(loaded)[1][0] < 3 * joint(path()[2])[1][0]
    )
    assert [name for name in c.names if name.endswith("upper_head")] == [
        "bolt0.upper_head",
        "bolt1.upper_head",
    ]


def test_friction_is_that_of_the_joint_or_the_heads():
    assert isinstance(am.cases.bolted_junction(friction=0.0).law, am.Frictionless)
    assert am.cases.bolted_junction().law.friction(
        np.array([[0.24, 0.0], [0.24, 0.04]])
    ).tolist() == [
        0.2,
        0.0,
    ]
    assert am.cases.bolted_junction(dim=3).law.friction == 0.2


test_refused = refused(
    *(
        (lambda options=options: am.cases.bolted_junction(**options), message)
        for options, message in (
            ({"preload": 0.0}, "preload must be > 0"),
            ({"dim": 3, "flanges": am.cases.Flanges(n_bolts=6)}, "multiple of 4"),
        )
    ),
    *(
        (lambda options=options: am.cases.Flanges(**options), message)
        for options, message in (
            ({"bore": -1.0}, "bore must be > 0"),
            ({"bolt_circle": 0.22}, "bolt_circle must leave room"),
            ({"length": 0.03}, "length must exceed"),
            ({"n_bolts": 48, "diameter": 0.02}, "do not fit"),
            ({"seat": 0.005}, "seat must be wider"),
        )
    ),
    (lambda: am.cases.bolted_junction(flanges={"bore": 0.2}), TypeError, "Flanges"),
)
