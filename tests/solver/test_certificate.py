"""The certificate: it shares nothing with the solvers, each line catches its fault, and the status needs it."""

from __future__ import annotations

import ast
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bodies import bar_hierarchy, bar_on_block
from scipy.sparse.linalg import spsolve

import adaptmg as am
from adaptmg.solver.certificate import Certificate, certify
from adaptmg.solver.record import Outcome

EXACT = am.ActiveSet(rtol=1e-12)
ROUNDING = 1e-13  # relative energy errors below say nothing
LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(2e7), "coulomb": am.Coulomb(1.0)}


def lifted_bar(law, dim=2):
    """The bar (block) pressed at one end, so that nodes are open, slip and stick."""
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    return replace(case, law=law, reference={})


@cache
def grids(kind="coulomb", dim=2):
    divisions = (4, 8, 16) if dim == 2 else (2, 4)
    return am.Hierarchy.uniform(lifted_bar(LAWS[kind], dim), divisions)


@cache
def exact(kind="coulomb", dim=2):
    return am.solve(grids(kind, dim), EXACT)


@dataclass(frozen=True)
class Returns:
    """A solver that says it has converged to what it was given."""

    displacement: np.ndarray
    rtol: float = 1e-6

    def run(self, hierarchy, run, start):
        return Outcome(self.displacement, am.Status.CONVERGED, cycles=1, rtol=self.rtol, error_estimate=0.0)


def returned(hierarchy, displacement):
    return am.solve(hierarchy, Returns(displacement), throw=False)


def energy(discrete, displacement):
    w = discrete.relative(displacement).ravel()
    return np.sqrt(w @ (discrete.matrix @ w))


def test_it_imports_nothing_of_the_solvers():
    folder = Path(am.solver.__file__).parent / "certificate"
    allowed = {"adaptmg._runtime", "adaptmg.discrete.problem",
               "adaptmg.solver.certificate", "adaptmg.solver.energy_error",
               "adaptmg.solver.aggregates",
               # arithmetic of small blocks, for the estimate of the energy error alone
               "adaptmg.smoother.blocks"}
    for file in folder.glob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        names |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        assert {name for name in names if name.startswith("adaptmg")} <= allowed, file.name


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_a_solution_violates_nothing(law, dim):
    certificate = exact(law, dim).certificate()
    assert not certificate.contradictions(1e-11)
    for line in certificate.lines:
        assert line.relative <= 1e-11, line
    assert certificate.energy_error <= 1e-11


@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(0.3)])
def test_a_solution_between_bodies_violates_nothing(law):
    result = am.solve(bar_hierarchy(bar_on_block(law), 2), EXACT)
    assert not result.certificate().contradictions(1e-10)
    assert {line.unit for line in result.certificate().lines} == {"N", "m", "N m", ""}


def test_the_scales_are_actual_forces_and_the_largest_displacement():
    result = exact()
    certificate, discrete = result.certificate(), grids().finest.discrete
    load, contact = np.linalg.norm(discrete.load), np.linalg.norm(result.contact.force)
    supports = result.reaction.copy()
    supports[result.contact.node] -= result.contact.force
    held = np.linalg.norm(supports[discrete.fixed.reshape(supports.shape)])
    assert certificate.force == pytest.approx(max(load, contact, held))
    assert certificate.displacement == np.abs(result.displacement).max()
    assert certificate.energy_norm == pytest.approx(energy(discrete, result.displacement))


class TestFaultyDisplacements:
    """What a solver returns is not the solution: the line that names the fault, and the status."""

    def caught(self, hierarchy, displacement, *names):
        result = returned(hierarchy, displacement)
        assert not result.status.ok
        found = result.certificate().contradictions(1e-6)
        assert set(names) <= set(found), found
        return result.certificate()

    def test_perturbed(self):
        noise = np.random.default_rng(1).normal(size=exact().displacement.shape)
        noise[grids().finest.discrete.fixed.reshape(noise.shape)] = 0.0
        u = exact().displacement + 1e-4 * np.abs(exact().displacement).max() * noise
        self.caught(grids(), u, "equilibrium", "penetration", "energy error")

    def test_flipped_displacement(self):
        self.caught(grids(), -exact().displacement, "equilibrium", "energy error")

    def test_forgotten_support(self):
        discrete = grids().finest.discrete
        held = discrete.fixed_values.copy()
        held[discrete.fixed] += 1e-5
        moved = replace(discrete, fixed_values=held)
        other = am.solve(moved, EXACT).displacement
        assert self.caught(grids(), other, "prescribed values", "energy error")[
            "prescribed values"].largest == pytest.approx(1e-5)

    def test_penetrating_node(self):
        u = exact().displacement.copy()
        contact = exact().contact
        i = int(np.argmax(contact.force_n))
        u[contact.node[i]] += 1e-7 * contact.normal[i]
        certificate = self.caught(grids(), u, "penetration", "equilibrium")
        assert certificate["penetration"].largest == pytest.approx(1e-7)

    def test_all_nodes_open(self):
        # held by springs at the contact nodes instead of the obstacle
        discrete = grids().finest.discrete
        far = replace(discrete, contact=replace(discrete.contact, gaps=discrete.contact.gaps + 1e-6))
        u = am.solve(far, EXACT).displacement
        assert self.caught(grids(), u, "penetration")["penetration"].largest == pytest.approx(1e-6, rel=1e-6)

    def test_hovering(self):
        discrete = grids().finest.discrete
        near = replace(discrete, contact=replace(discrete.contact, gaps=discrete.contact.gaps - 1e-6,
                                                 allow_interference=True))
        u = am.solve(near, EXACT).displacement
        certificate = self.caught(grids(), u, "complementarity", "open, touching")
        assert certificate["open, touching"].largest == pytest.approx(exact().contact.force_n.max(), rel=0.2)

    def test_tension(self):
        # glued to the obstacle
        discrete, u = grids().finest.discrete, np.zeros_like(exact().displacement)
        free = ~discrete.fixed.reshape(u.shape)
        free[exact().contact.node] = False
        matrix = discrete.matrix.tocsc()[free.ravel()][:, free.ravel()]
        u[free] = spsolve(matrix, discrete.load[free.ravel()])
        self.caught(grids(), u, "tension", "friction bound")

    @pytest.mark.parametrize(("law", "names"), [
        (am.Coulomb(2.0), ("friction bound",)), (am.Coulomb(0.5), ("slip direction",)),
        (am.Frictionless(), ("slip direction",))], ids=["more friction", "less friction", "none"])
    def test_another_law(self, law, names):
        u = am.solve(replace(grids().finest.discrete, law=law), EXACT).displacement
        self.caught(grids(), u, *names)

    def test_slip_along_the_force(self):
        # the slip is measured against a displacement beyond: what slid one way has slid the other
        discrete, contact = grids().finest.discrete, exact().contact
        beyond = replace(discrete, contact=replace(
            discrete.contact, slip_reference=2 * exact().displacement[contact.node]))
        result = am.solve(beyond, Returns(exact().displacement), throw=False)
        assert not result.status.ok
        assert {"slip direction", "slip along the force"} <= set(result.certificate().contradictions(1e-6))

    def test_flipped_normals(self):
        discrete = grids().finest.discrete
        flipped = replace(discrete, contact=replace(discrete.contact, normals=-discrete.contact.normals))
        certificate = certify(flipped, exact().displacement, exact().contact)
        assert {"tension", "penetration"} <= set(certificate.contradictions(1e-6))

    @pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
    def test_not_finite_or_run_away(self, value):
        u = exact().displacement.copy()
        u[5] = value
        certificate = certify(grids().finest.discrete, u, exact().contact)
        assert "equilibrium" in certificate.contradictions(1e-2)


class TestFaultyClaims:
    """The displacement is right, the forces or states that go with it are not."""

    def contradictions(self, **changes):
        contact = replace(exact().contact, **changes)
        return certify(grids().finest.discrete, exact().displacement, contact).contradictions(1e-8)

    def test_flipped_friction(self):
        assert {"equilibrium", "slip direction", "slip along the force"} <= set(
            self.contradictions(force_t=-exact().contact.force_t))

    def test_flipped_pressure(self):
        assert {"equilibrium", "tension"} <= set(self.contradictions(force_n=-exact().contact.force_n))

    def test_too_much_friction(self):
        assert {"equilibrium", "friction bound"} <= set(self.contradictions(force_t=2 * exact().contact.force_t))

    def test_no_contact_forces(self):
        nothing = np.zeros_like(exact().contact.force_t)
        found = self.contradictions(force_n=nothing[:, 0], force_t=nothing)
        assert {"equilibrium", "balance"} <= set(found)

    @pytest.mark.parametrize(("was", "said", "name"), [
        (am.SLIP, am.STICK, "slip, sticking"), (am.SLIP, am.OPEN, "open, touching"),
        (am.STICK, am.OPEN, "open, touching"), (am.OPEN, am.SLIP, "touching, open")])
    def test_wrong_state(self, was, said, name):
        contact = exact().contact
        free = ~grids().finest.discrete.fixed.reshape(-1, 2)[contact.node].any(axis=1)
        assert (contact.state[free] == was).any()
        assert self.contradictions(state=np.where(contact.state == was, said, contact.state)) == (name,)

    def test_masters_do_not_balance(self):
        hierarchy = bar_hierarchy(bar_on_block(am.Coulomb(0.3)), 2)
        result = am.solve(hierarchy, EXACT)
        contact = replace(result.contact, master_force=-result.contact.master_force)
        found = certify(hierarchy.finest.discrete, result.displacement, contact).contradictions(1e-8)
        assert {"equilibrium", "balance"} <= set(found)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("solver", [am.FullMultigrid(rtol=1e-3), am.FullMultigrid(rtol=1e-6), am.Multigrid(rtol=1e-5),
                                    am.FullMultigrid(rtol=1e-4, correction=am.Monotone()),
                                    am.SingleGrid(rtol=1e-3, omega=1.8)], ids=repr)
def test_the_energy_error_is_estimated(solver, law, dim):
    discrete = grids(law, dim).finest.discrete
    result = am.solve(grids(law, dim), solver, throw=False)
    true = energy(discrete, result.displacement - exact(law, dim).displacement) / energy(
        discrete, exact(law, dim).displacement)
    # where the solver ends far below its tolerance, both are rounding
    estimate, bound = (max(found.energy_error, ROUNDING)
                       for found in (result.certificate(), result.certificate(discrete, bound=True)))
    true = max(true, ROUNDING)
    assert 0.5 * true <= estimate <= 1.5 * true
    assert 0.8 * true <= bound <= 1.2 * true


def test_one_step_sees_what_is_smooth(monkeypatch):
    """Hats that keep the contact status; constants over boxes that leave contact out see a third of it here."""
    monkeypatch.setattr("adaptmg.solver.energy_error._MANY", (1, 0.0))
    hierarchy = am.Hierarchy.uniform(lifted_bar(LAWS["coulomb"]), (4, 8, 16, 32, 64))
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-6), throw=False)
    true = result.certificate(hierarchy.finest.discrete, bound=True).energy_error
    assert 0.75 * true <= certify(hierarchy.finest.discrete, result.displacement, result.contact).energy_error


def test_an_energy_error_beyond_the_tolerance_takes_converged_back():
    discrete, u = grids().finest.discrete, exact().displacement
    # smooth: the residual hardly shows it
    smooth = u * (1 + 2e-5 * discrete.coordinates[:, :1] / 0.04)
    error = energy(discrete, smooth - u) / energy(discrete, u)
    assert am.solve(grids(), Returns(smooth, rtol=3 * error), throw=False).status.ok
    assert not am.solve(grids(), Returns(smooth, rtol=0.1 * error), throw=False).status.ok


def test_rigid_motion_in_supports_is_no_excuse():
    """Errors count against the energy of the displacement, not against that of a jump at the support."""
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=2e11, poisson=0.3), domain=am.Rectangle(width=0.04, height=0.04),
        contact=am.Contact("bottom", am.GapFunction(lambda x: np.full(len(x), 9.99e-3))), law=am.Coulomb(0.3),
        supports=(am.Support("top", x=0.0, y=-0.01),))
    hierarchy = am.Hierarchy.uniform(problem, (4, 8))
    u = am.solve(hierarchy, am.ActiveSet(rtol=1e-12), throw=False).displacement
    wrong = u.copy()
    inner = ~hierarchy.finest.discrete.fixed.reshape(u.shape).any(axis=1)
    inner[hierarchy.finest.discrete.contact.nodes] = False
    wrong[inner, 0] += 1e-8
    error = energy(hierarchy.finest.discrete, wrong - u) / energy(hierarchy.finest.discrete, u)
    certificate = am.solve(hierarchy, Returns(wrong), throw=False).certificate()
    assert error > 1e-4 and 0.5 * error < certificate.energy_error < 1.5 * error


def test_it_is_printed_kept_and_made_anew(tmp_path):
    result = exact()
    assert f"worst {result.certificate().worst.name}" in repr(result)
    text = repr(result.certificate())
    assert all(line.name in text for line in result.certificate().lines) and "energy error" in text
    result.save(tmp_path / "run.npz")
    loaded = am.Result.load(tmp_path / "run.npz")
    assert loaded.certificate() == result.certificate() and isinstance(loaded.certificate(), Certificate)
    anew = loaded.certificate(grids().finest.discrete, bound=True)
    assert anew.exact_energy and anew.lines == result.certificate().lines
    with pytest.raises(ValueError, match=r"^problem: this result keeps no matrix"):
        loaded.certificate(bound=True)
    with pytest.raises(TypeError, match="problem must be"):
        loaded.certificate(grids())
    with pytest.raises(KeyError, match="no line 'gap'"):
        anew["gap"]


def test_steps_of_a_path_have_one():
    results = am.solve_path(grids(), am.LoadPath(default=[0.5, 1.0, 0.8]), am.FullMultigrid())
    for result in results:
        assert not result.certificate().contradictions(1e-7)


class TestFrictionAtSupports:
    """Nodes that a support drives along the contact: friction acts there as everywhere."""

    def driven(self):
        problem = am.ContactProblem(
            domain=am.Rectangle(width=40e-3, height=20e-3), material=am.PlaneStrain(young=2.1e11, poisson=0.3),
            contact=am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1))), law=am.Coulomb(0.4),
            loads=(am.Pressure("top", 1e7),), supports=(am.Support("left", x=1e-4), am.Support("right", x=1e-4)))
        return am.Hierarchy.uniform(problem, ((4, 2), (8, 4)))

    def between(self):
        parts = {"pad": am.Rectangle(width=40e-3, height=20e-3),
                 "plate": am.Rectangle(width=80e-3, height=20e-3, origin=(-20e-3, -20e-3))}
        problem = am.ContactProblem(
            domain=am.Assembly(parts=parts), material=am.PlaneStrain(young=2.1e11, poisson=0.3), law=am.Coulomb(0.4),
            contact=am.ContactPair("pad.bottom", "plate.top"), loads=(am.Pressure("pad.top", 1e7),),
            supports=(am.Support("pad.left", x=0.0), am.Support("pad.right", x=0.0),
                      am.Support("plate.bottom", x=1e-3, y=0.0)))
        return am.Hierarchy.uniform(problem, [{"pad": (k, k // 2), "plate": (2 * k, k // 2)} for k in (4, 8)])

    @pytest.mark.parametrize("make", ["driven", "between"])
    def test_faults_there_are_caught(self, make):
        hierarchy = getattr(self, make)()
        # 1 mm of slip against micrometres of strain: fewer digits
        discrete, result = hierarchy.finest.discrete, am.solve(hierarchy, am.ActiveSet(rtol=1e-10))
        contact = result.contact
        assert not result.certificate().contradictions(1e-9)
        held = discrete.fixed.reshape(result.displacement.shape)[contact.node].any(axis=1)
        assert held.sum() == 2 and (contact.force_n[held] > 0).all()
        none = contact.force_t * ~held[:, None]
        found = certify(discrete, result.displacement, replace(contact, force_t=none))
        assert "slip direction" in found.contradictions(1e-6)
        twice = contact.force_t * (1 + held[:, None])
        found = certify(discrete, result.displacement, replace(contact, force_t=twice))
        assert "friction bound" in found.contradictions(1e-6)
        stuck = replace(contact, state=np.where(held, am.STICK, contact.state))
        assert certify(discrete, result.displacement, stuck).contradictions(1e-6) == ("slip, sticking",)
        if make == "between":
            # the master must carry the friction of held nodes, too
            share = np.zeros_like(contact.master_force)
            share[np.argmax(np.abs(contact.master_force[:, 0])), 0] = 0.1 * np.abs(contact.master_force).max()
            wrong = replace(contact, master_force=contact.master_force + share)
            assert "equilibrium" in certify(discrete, result.displacement, wrong).contradictions(1e-6)
