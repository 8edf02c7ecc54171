"""The bolted junction: equilibrium, preload, what the pressure does, 2D beside 3D, agreement of methods, bad input."""

from __future__ import annotations

import math
import pickle
from functools import lru_cache

import numpy as np
import pytest

import adaptmg as am
from adaptmg.cases import Flanges, bolt_force, bolted_junction, joint_opening, junction_path, open_to, sealing_pressure

MM = 1e-3
SIZES = (12 * MM, 7 * MM, 4 * MM)
PRESSURES = (2e6, 4e6, 6e6, 8e6)


@lru_cache(maxsize=8)
def grids(bolt: str, friction: float = 0.2) -> am.Hierarchy:
    return am.Hierarchy.graded(bolted_junction(bolt=bolt, friction=friction), SIZES, contact_ratio=2)


@lru_cache(maxsize=8)
def solved(bolt: str) -> am.Result:
    return am.solve(grids(bolt), am.ActiveSet(rtol=1e-12))


@lru_cache(maxsize=2)
def path() -> am.PathResult:
    """Tightened, then under pressure."""
    problem = bolted_junction()
    return am.solve_path(grids("ring"), junction_path(problem, PRESSURES), am.ActiveSet())


@lru_cache(maxsize=2)
def sector() -> am.PathResult:
    problem = bolted_junction(dim=3)
    hierarchy = am.Hierarchy.graded(problem, (28 * MM,))
    return am.solve_path(hierarchy, junction_path(problem, [4e6]), am.ActiveSet())


@pytest.mark.parametrize("bolt", ["ring", "traction"])
def test_the_joint_carries_bolt_force_less_thrust(bolt):
    result, flanges = solved(bolt), Flanges()
    thrust = 4e6 * math.pi * 0.2**2
    force = 2.5e6 if bolt == "traction" else bolt_force(result)
    joint = result.resultant("upper.joint").force[1]
    assert joint == pytest.approx(force - thrust, rel=1e-10)
    assert flanges.thrust(4e6) == pytest.approx(thrust)
    # what the end of the upper pipe pulls, the support at the end of the lower one holds
    assert result.resultant("lower.pipe").force[1] == pytest.approx(-thrust, rel=1e-9)


@pytest.mark.parametrize("pair", [("upper.joint", "lower.joint"), ("bolt.upper_head", "upper.seat"),
                                  ("bolt.lower_head", "lower.seat")])
def test_forces_of_each_pair_balance(pair):
    slave, master = (solved("ring").resultant(name).force for name in pair)
    # radial forces of axisymmetry are no resultant, but they balance as well
    assert np.abs(slave + master).max() < 1e-12 * 2.5e6


def test_the_bolt_is_in_equilibrium_under_its_two_heads():
    c = solved("ring").contact
    upper, lower = (c.force_n[c.boundary == k].sum() for k in (1, 2))
    assert upper == pytest.approx(lower, rel=1e-10)


def test_tightened_bolts_have_about_their_preload():
    result = path()[0]
    assert bolt_force(result) == pytest.approx(2.5e6, rel=0.06)
    assert joint_opening(result) == pytest.approx(0.0, abs=1e-12)
    assert open_to(result) == pytest.approx(0.2)


def test_without_pressure_the_bolt_force_is_proportional_to_the_shortening():
    forces = []
    for shortening in (1e-4, 2e-4):
        problem = bolted_junction(shortening=shortening, pressure=0.0)
        meshes = [level.mesh for level in grids("ring").levels[:2]]
        forces.append(bolt_force(am.solve(am.Hierarchy.from_meshes(problem, meshes), am.ActiveSet())))
    assert forces[1] == pytest.approx(2 * forces[0], rel=1e-9)


def test_the_bolts_hardly_feel_the_pressure_until_the_joint_opens():
    results = path()
    force = np.array([bolt_force(r) for r in results])
    thrust = np.array([0.0, *(Flanges().thrust(p) for p in PRESSURES)])
    opening = np.array([joint_opening(r) for r in results])
    assert (np.diff(opening) > 0).all()
    assert (np.diff([open_to(r) for r in results]) > 0).all()
    share = np.diff(force) / np.diff(thrust)
    # closed on the bolt circle the flanges take the thrust from the joint; open, the bolts take it
    assert (np.abs(share[:2]) < 0.06).all()
    assert share[-1] > 0.3
    assert (np.diff(share) > 0).all()
    seal = [sealing_pressure(r, Flanges()) for r in results]
    assert seal[2] > 4e6 and seal[3] < 6e6


def test_values_by_mesh_convergence():
    for bolt in ("ring", "traction"):
        values, result = bolted_junction(bolt=bolt).reference["values"], solved(bolt)
        c = result.contact
        joint = np.flatnonzero(c.boundary == 0)
        r, state = c.x[joint, 0], c.state[joint]
        assert open_to(result) == pytest.approx(values["open_to"], abs=2 * MM)
        assert r[state == am.SLIP].max() == pytest.approx(values["slip_to"], abs=2 * MM)
        assert joint_opening(result) == pytest.approx(values["gap"], rel=0.08)
        assert c.pressure[joint].max() == pytest.approx(values["peak"], rel=0.06)
        assert c.force_n[joint].sum() == pytest.approx(values["joint_force"], rel=0.07)
    assert "reconstruction" in bolted_junction().reference["remark"]
    assert "values" not in bolted_junction(pressure=3e6).reference
    assert "values" not in bolted_junction(shortening=1e-4).reference


@pytest.mark.parametrize("bolt", ["ring", "traction"])
def test_multigrid_agrees_with_the_active_set_method(bolt):
    result = am.solve(grids(bolt), am.FullMultigrid(rtol=1e-10))
    exact = solved(bolt)
    assert result.status.ok and not result.fallback
    error = (result.displacement - exact.displacement).reshape(-1)
    assert np.linalg.norm(error) < 1e-8 * np.linalg.norm(exact.displacement)
    assert (result.contact.state == exact.contact.state).all()


def test_three_dimensions_beside_the_ring():
    results = sector()
    force = [bolt_force(r) for r in results]
    # coarse meshes are too stiff, and the force of shortened bolts too large
    assert 1.0 < force[0] / bolt_force(path()[0]) < 1.1
    thrust = 4 * results[1].resultant("lower.pipe").force[2]
    assert -thrust == pytest.approx(Flanges().thrust(4e6), rel=0.01)
    # the ends of a bore of chords are not quite alike, so that the pressure on it has a small axial force too
    joint = 4 * results[1].resultant("upper.joint").force[2]
    assert joint == pytest.approx(force[1] + thrust, rel=1e-3)
    c = results[1].contact
    lower = sum(c.force_n[c.boundary == c.names.index(f"bolt{k}.lower_head")].sum() for k in (0, 1))
    assert 4 * lower == pytest.approx(force[1], rel=1e-9)
    for slave, master in (("upper.joint", "lower.joint"), ("bolt0.upper_head", "upper.face")):
        balance = results[1].resultant(slave).force + results[1].resultant(master).force
        if slave == "bolt0.upper_head":
            balance = balance + results[1].resultant("bolt1.upper_head").force
        assert np.abs(balance).max() < 1e-12 * 2.5e6
    assert abs(force[1] - force[0]) < 0.1 * -thrust
    assert 0 < joint_opening(results[1]) < 3 * joint_opening(path()[2])
    with pytest.raises(ValueError, match="sealing_pressure is for the axisymmetric"):
        sealing_pressure(results[1], Flanges())
    with pytest.raises(ValueError, match="open_to is for the axisymmetric"):
        open_to(results[1])
    heads = [name for name in results[1].contact.names if name.endswith("upper_head")]
    assert heads == ["bolt0.upper_head", "bolt1.upper_head"]


def test_without_friction():
    result = am.solve(grids("ring", 0.0), am.ActiveSet())
    assert np.abs(result.contact.force_t).max() < 1e-12 * 2.5e6
    assert isinstance(bolted_junction(friction=0.0).law, am.Frictionless)


def test_problems_can_be_pickled():
    problem = pickle.loads(pickle.dumps(bolted_junction()))
    assert problem.law.friction(np.array([[0.24, 0.0], [0.24, 0.04]])).tolist() == [0.2, 0.0]


@pytest.mark.parametrize(("arguments", "message"), [
    ({"dim": 1}, "dim"),
    ({"bolt": "solid"}, "bolt"),
    ({"dim": 3, "bolt": "ring"}, "bolt"),
    ({"preload": 0.0}, "preload must be > 0"),
    ({"pressure": math.nan}, "pressure"),
    ({"friction": -0.1}, "friction must be >= 0"),
    ({"bolt": "traction", "shortening": 1e-4}, "no bolts to shorten"),
    ({"bolt": "traction", "head_friction": 0.1}, "no heads"),
    ({"dim": 3, "head_friction": 0.0}, "holds the bolts sideways"),
    ({"dim": 3, "flanges": Flanges(n_bolts=6)}, "multiple of 4"),
])
def test_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        bolted_junction(**arguments)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"bore": -1.0}, "bore must be > 0"),
    ({"bolt_circle": 0.22}, "bolt_circle must leave room"),
    ({"length": 0.03}, "length must exceed"),
    ({"n_bolts": 48, "diameter": 0.02}, "do not fit"),
    ({"seat": 0.005}, "seat must be wider"),
])
def test_bad_dimensions(arguments, message):
    with pytest.raises(ValueError, match=message):
        Flanges(**arguments)


def test_bad_measures():
    other = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4,)))
    for measure in (bolt_force, joint_opening, open_to):
        with pytest.raises(ValueError, match="not one of a bolted junction"):
            measure(other)
        with pytest.raises(TypeError, match="Result"):
            measure(None)
    with pytest.raises(ValueError, match="no bolts"):
        bolt_force(solved("traction"))
    with pytest.raises(TypeError, match="bolted_junction"):
        junction_path(am.cases.greco_bar(), [1e6])
    with pytest.raises(ValueError, match="no pressure"):
        junction_path(bolted_junction(pressure=0.0), [1e6])
    with pytest.raises(TypeError, match="Flanges"):
        bolted_junction(flanges={"bore": 0.2})
