"""solve(), Result and the methods: agreement, records, failure paths, one's own parts."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.solver.record import Outcome

PROBLEMS = {
    "coulomb 0.2": lambda: am.cases.greco_bar(law=am.Coulomb(0.2)),
    "coulomb 1": lambda: am.cases.greco_bar(law=am.Coulomb(1.0)),
    "coulomb in space": lambda: am.cases.greco_bar(law=am.Coulomb(lambda x: 0.2 + 20 * x[:, 0])),
    "tresca": lambda: am.cases.greco_bar(law=am.Tresca(3e7)),
    "curved obstacle": lambda: am.cases.curved_obstacle(),
    "upset block": lambda: am.cases.upset_block(),
    "block": lambda: am.cases.greco_block(law=am.Coulomb(0.5)),
}


def grids_of(name):
    if name == "block":
        return am.Hierarchy.uniform(PROBLEMS[name](), divisions=(2, 4))
    return am.Hierarchy.uniform(PROBLEMS[name](), divisions=(4, 8, 16))


@pytest.fixture(scope="module")
def solved():
    """Grids and reference solutions by an independent method: semismooth Newton with direct solves."""
    result = {}
    for name in PROBLEMS:
        grids = grids_of(name)
        result[name] = grids, am.solve(grids, am.ActiveSet(rtol=1e-12))
    return result


def energy_error(grids, result, reference):
    matrix = grids.finest.discrete.matrix
    error = (result.displacement - reference.displacement).reshape(-1)
    u = reference.displacement.reshape(-1)
    return np.sqrt(error @ (matrix @ error) / (u @ (matrix @ u)))


METHODS = {
    "V": am.Multigrid(correction=am.Monotone(), rtol=1e-10),
    "W post": am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="W", pre=1, post=1), rtol=1e-10),
    "complete": am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape="complete"), rtol=1e-10),
    "full F": am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape="F"), rtol=1e-10),
    "minmod": am.FullMultigrid(correction=am.PaperCorrection(slip="minmod", limit="summed"), rtol=1e-10),
    "discretised": am.Multigrid(correction=am.Monotone(), coarse_matrices="discretised", rtol=1e-10),
    "single": am.SingleGrid(rtol=1e-10, omega=1.5),
    "condensed": am.SingleGrid(rtol=1e-10, condensed=True),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_methods_agree_with_the_active_set(solved, name, method):
    grids, reference = solved[name]
    result = am.solve(grids, METHODS[method], reference=reference)
    assert result.status.ok
    error = energy_error(grids, result, reference)
    assert error < 1e-9
    assert result.history["true_error"][-1] == pytest.approx(error, rel=0.05, abs=1e-12)
    assert result.residual < 1e-9
    # the estimate must not flatter by more than a small factor
    assert error <= 5 * max(result.error_estimate, 1e-12)


def test_fixed_point_over_tresca_reaches_the_same_solution(solved):
    grids, reference = solved["coulomb 1"]
    result = am.solve(grids, am.SingleGrid(friction="fixed point", rtol=1e-8, omega=1.5))
    assert energy_error(grids, result, reference) < 1e-7


@pytest.mark.parametrize("solver", [am.FullMultigrid(correction=am.Monotone(), rtol=1e-11),
                                    am.FullMultigrid(correction=am.Truncated(), rtol=1e-12)])
@pytest.mark.parametrize("name", PROBLEMS)
def test_contact_conditions(solved, name, solver):
    grids, _ = solved[name]
    result = am.solve(grids, solver)
    c = result.contact
    force, length = np.abs(c.force_n).max(), np.abs(result.displacement).max()
    assert (c.gap >= -1e-15).all()
    assert (c.force_n >= 0).all()
    assert (c.gap * c.force_n).max() < 1e-9 * force * length
    size = np.linalg.norm(c.force_t, axis=1)
    assert (size <= c.limit + 1e-8 * force).all()
    slips = c.state == am.SLIP
    # friction opposes the slip with all that the law allows
    along = np.sum(c.force_t * c.slip, axis=1)
    assert (along[slips] <= 1e-12 * force * length).all()
    assert np.abs(size - c.limit)[slips].max(initial=0) < 1e-7 * force
    assert (np.linalg.norm(c.slip, axis=1)[c.state == am.STICK] == 0).all()
    assert set(np.unique(c.state)) <= {am.OPEN, am.SLIP, am.STICK}


def test_resultants_balance_the_loads(solved):
    for name in ("coulomb 1", "block"):
        grids, result = solved[name]
        discrete = grids.finest.discrete
        load = discrete.load.reshape(-1, discrete.dim).sum(axis=0)
        supports = ("right", "front", "back") if name == "block" else ("right",)
        total = contact_force(result) + sum(result.resultant(name).force for name in supports)
        assert total == pytest.approx(-load, abs=1e-9 * np.abs(load).max())
        nodes = np.unique(np.concatenate([grids.finest.mesh.boundary_nodes(s) for s in supports]))
        contact = result.resultant("contact")
        reaction = result.reaction.sum(axis=0)
        assert reaction == pytest.approx(-load, abs=1e-9 * np.abs(load).max())
        free = np.setdiff1d(np.arange(discrete.n_nodes), np.union1d(nodes, result.contact.node))
        assert np.abs(result.reaction[free]).max() < 1e-9 * np.abs(load).max()
        assert result.resultant("bottom").force == pytest.approx(contact.force)
    grids, result = solved["coulomb 1"]
    assert (result.resultant("right").force + contact_force(result)) == pytest.approx(
        -grids.finest.discrete.load.reshape(-1, 2).sum(axis=0), rel=1e-9)
    # moments about any point balance too
    x = grids.finest.mesh.points
    load = grids.finest.discrete.load.reshape(-1, 2)
    for about in ((0.0, 0.0), (0.1, -0.3)):
        arm = x - about
        moment = np.sum(arm[:, 0] * load[:, 1] - arm[:, 1] * load[:, 0])
        total = result.resultant("contact", about).moment + result.resultant("right", about).moment
        assert total == pytest.approx(-moment, rel=1e-8)


def test_a_force_at_a_shared_corner_belongs_to_the_support_that_holds_it(tmp_path):
    """A square between two rollers and the plane, in homogeneous compression: each side carries its pressure."""
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3), domain=am.Rectangle(width=1.0, height=1.0),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))), law=am.Frictionless(),
        loads=(am.Pressure("right", 1e6),), supports=(am.Support("left", x=0.0), am.Support("top", y=-1e-3)))
    result = am.solve(am.Hierarchy.uniform(problem, (3,)), am.ActiveSet())
    result.save(tmp_path / "run.npz")
    for found in (result, am.Result.load(tmp_path / "run.npz")):
        assert found.resultant("left").force == pytest.approx([1e6, 0], abs=1e-3)
        assert found.resultant("top").force == pytest.approx([0, -contact_force(result)[1]], abs=1e-3)
        assert found.resultant("right").force == pytest.approx([0, 0], abs=1e-3)


def test_a_component_that_two_supports_hold_at_a_corner_is_shared():
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3), domain=am.Rectangle(width=1.0, height=1.0),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))), law=am.Coulomb(0.3),
        loads=(am.Traction("right", (2e5, -1e5)),),
        supports=(am.Support("left", x=0.0), am.Support("top", x=0.0, y=0.0)))
    grids = am.Hierarchy.uniform(problem, (4,))
    result = am.solve(grids, am.ActiveSet())
    total = sum(result.resultant(name).force for name in ("left", "top", "right", "bottom"))
    assert total == pytest.approx([-2e5, 1e5], abs=1e-3)
    corner = np.flatnonzero((result.mesh.points == [0, 1]).all(axis=1))[0]
    inner = np.setdiff1d(result.mesh.boundary_nodes("top"), [corner])
    assert result.resultant("top").force == pytest.approx(
        result.reaction[inner].sum(axis=0) + [0.5, 1.0] * result.reaction[corner], abs=1e-3)


def contact_force(result):
    return result.resultant("contact").force


def test_result_saves_and_loads(solved, tmp_path):
    grids, _ = solved["coulomb 1"]
    result = am.solve(grids, am.FullMultigrid())
    result.save(tmp_path / "run.npz")
    again = am.Result.load(tmp_path / "run.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
    assert np.array_equal(again.displacement, result.displacement)
    assert again.status is result.status
    assert again.timings == result.timings
    assert again.path == result.path
    assert repr(again.levels) == repr(result.levels)
    assert np.array_equal(again.contact.pressure, result.contact.pressure)
    assert np.array_equal(again.probe([(0.0, 0.0), (0.005, 0.0)]), result.probe([(0.0, 0.0), (0.005, 0.0)]))
    assert np.array_equal(again.resultant("right").force, result.resultant("right").force)
    assert repr(again) == repr(result)


def test_load_refuses_other_files(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    with pytest.raises(ValueError, match="not a result"):
        am.Result.load(tmp_path / "other.npz")


def test_a_failed_save_leaves_the_old_file(solved, tmp_path, monkeypatch):
    _, result = solved["coulomb 1"]
    target = tmp_path / "run.npz"
    target.write_bytes(b"old")
    monkeypatch.setattr("os.replace", lambda *names: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        result.save(target)
    assert target.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_probe(solved):
    grids, result = solved["coulomb 1"]
    nodes = [0, 17, 100]
    assert result.probe(grids.finest.mesh.points[nodes]) == pytest.approx(result.displacement[nodes], rel=1e-12)
    with pytest.raises(ValueError, match="outside the mesh"):
        result.probe([(0.0, -0.01)])
    with pytest.raises(ValueError, match="shape"):
        result.probe([(0.0, 0.0, 0.0)])
    bare = am.solve(grids.finest.discrete, am.SingleGrid(rtol=1e-3))
    with pytest.raises(ValueError, match="no mesh"):
        bare.probe([(0.0, 0.0)])


def test_not_converged_carries_the_result(solved):
    grids, _ = solved["coulomb 1"]
    for solver in (am.Multigrid(max_cycles=2), am.SingleGrid(max_sweeps=20)):
        with pytest.raises(am.NotConverged) as caught:
            am.solve(grids, solver)
        assert caught.value.result.status is am.Status.LIMIT
        assert "natural residual" in str(caught.value)
        assert not am.solve(grids, solver, throw=False).status.ok


def test_the_estimate_is_of_the_error_not_of_the_change(solved):
    """A slow iteration (omega 1) must not stop on its small change."""
    grids, reference = solved["coulomb 1"]
    result = am.solve(grids, am.SingleGrid(rtol=1e-5), reference=reference)
    assert result.history["true_error"][-1] < 2e-5
    paper = am.solve(grids, am.SingleGrid(rtol=1e-5, stop="change"), reference=reference, throw=False)
    assert paper.history["true_error"][-1] > 1e-4
    assert paper.status is am.Status.STALLED


def test_start(solved):
    grids, reference = solved["coulomb 1"]
    cold = am.solve(grids, am.Multigrid())
    warm = am.solve(grids, am.Multigrid(), start=reference)
    assert warm.cycles < cold.cycles / 2
    with pytest.raises(ValueError, match="start must have shape"):
        am.solve(grids, am.Multigrid(), start=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="finite"):
        am.solve(grids, am.Multigrid(), start=np.full(reference.displacement.shape, np.nan))
    with pytest.raises(ValueError, match="its own start"):
        am.solve(grids, am.FullMultigrid(), start=reference)


def test_history_is_reported_as_it_goes(solved):
    grids, _ = solved["coulomb 1"]
    rows = []
    result = am.solve(grids, am.FullMultigrid(correction=am.Monotone()), callback=rows.append)
    assert len(rows) == len(result.history["cycle"]) == result.cycles + 1
    assert (np.diff(result.history["work_units"]) > 0).all()
    assert result.history["work_units"][-1] == result.work_units
    assert 0 < result.start_work_units < result.work_units
    assert {"setup", "start", "cycles"} <= set(result.timings)


def test_frictionless_bar_is_exact_after_zero_cycles():
    """The patch test of VALIDATION 1: a nested start is exact, whatever the grid."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Frictionless()), divisions=(4, 8, 16))
    result = am.solve(grids, am.FullMultigrid(correction=am.Monotone(), start=am.NestedStart(rtol=1e-14)))
    assert result.cycles <= 1
    assert result.probe([(0.0, 0.0)])[0, 0] == pytest.approx(4.0615384615e-5, rel=1e-9)


@dataclass(frozen=True)
class HalfWeights:
    """One's own transfer: on nested uniform grids, by coordinates alone."""

    def build(self, coarse, fine):
        rows, columns, values = [], [], []
        where = {tuple(np.round(x / 1e-3, 6)): k for k, x in enumerate(coarse.points)}
        h = np.ptp(coarse.points[:, 0]) / (np.sqrt(coarse.n_nodes) - 1)
        for i, x in enumerate(fine.points):
            for step in ((0, 0), (h / 2, 0), (0, h / 2), (h / 2, h / 2)):
                ends = [tuple(np.round((x + s * np.array(step)) / 1e-3, 6)) for s in (1, -1)]
                if all(end in where for end in ends):
                    for end in ends:
                        rows.append(i)
                        columns.append(where[end])
                        values.append(0.5)
                    break
        return sparse.csr_array((values, (rows, columns)), shape=(fine.n_nodes, coarse.n_nodes))


class Jacobi:
    """One's own smoother: damped, projected, for a frictionless problem."""

    def smooth(self, system, contact, load, unknowns, sweeps=1):
        normal = system.nodes * system.dim
        diagonal = system.matrix.diagonal()
        for _ in range(sweeps):
            unknowns += 0.5 * (load - system.matrix @ unknowns) / diagonal
            unknowns[normal] = np.minimum(unknowns[normal], contact.gap)
        return float(sweeps)


def test_ones_own_transfer_and_smoother_plug_in():
    problem = am.cases.curved_obstacle()
    meshes = [am.mesh.structured(problem.domain, n) for n in (4, 8, 16)]
    own = am.Hierarchy.from_meshes(problem, meshes, transfer=HalfWeights())
    grids = am.Hierarchy.from_meshes(problem, meshes)
    assert abs(own[2].prolongation - grids[2].prolongation).max() < 1e-12
    reference = am.solve(grids, am.ActiveSet(rtol=1e-12))
    solver = am.Multigrid(correction=am.Monotone(), smoother=Jacobi(), max_cycles=300, rtol=1e-9)
    result = am.solve(own, solver, reference=reference)
    assert energy_error(grids, result, reference) < 1e-8


@dataclass(frozen=True)
class Claims:
    """A user-defined solver that returns a multiple of a displacement and says that it is exact."""

    displacement: np.ndarray
    rtol: float

    def run(self, hierarchy, run, start):
        return Outcome(self.displacement, am.Status.CONVERGED, 1, self.rtol, 1e-12)


def test_no_error_estimate_is_better_than_the_certificate_and_nothing_solved_is_not_converged():
    bar = grids_of("coulomb 1")
    solution = am.solve(bar, am.ActiveSet()).displacement
    for factor, rtol, status in ((0.0, 0.5, "STALLED"), (0.9, 0.5, "CONVERGED"), (0.9, 1e-2, "STALLED")):
        result = am.solve(bar, Claims(factor * solution, rtol), throw=False)
        assert result.error_estimate >= result.checked.energy_error > 0.05
        assert result.status is am.Status[status]
    # unconverged, where the rate of the cycles promises much
    for cycles in (2, 5):
        result = am.solve(bar, am.Multigrid(max_cycles=cycles), throw=False)
        assert result.error_estimate >= result.checked.energy_error


def test_a_smoother_is_refused_where_the_correction_has_its_own():
    for method in (am.Multigrid, am.FullMultigrid):
        with pytest.raises(ValueError, match=r"smoother must be left at its default.*give correction=am.Monotone"):
            method(smoother=Jacobi())
        assert method(smoother=Jacobi(), correction=am.Monotone()).correction == am.Monotone()


def test_large_friction_warns():
    for friction, warns in ((1.0, False), (20.0, True)):
        grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(4, 8))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            am.solve(grids, am.SingleGrid(max_sweeps=10), throw=False)
        assert any("may not be unique" in str(w.message) for w in caught) == warns


def test_bad_input_is_refused(solved):
    grids, _ = solved["coulomb 1"]
    with pytest.raises(TypeError, match="Hierarchy or a DiscreteProblem"):
        am.solve("bar")
    with pytest.raises(TypeError, match="solver must be"):
        am.solve(grids, solver="multigrid")
    with pytest.raises(ValueError, match="at least two levels"):
        am.solve(grids.truncated(coarsest=2), am.Multigrid())
    with pytest.raises(ValueError, match="rtol"):
        am.Multigrid(rtol=np.nan)
    with pytest.raises(ValueError, match="omega"):
        am.SingleGrid(omega=2.5)
    with pytest.raises(TypeError, match="smoother"):
        am.Multigrid(smoother=3)
    with pytest.raises(TypeError, match="correction"):
        am.Multigrid(correction="monotone")
    with pytest.raises(ValueError, match="cycles"):
        am.multigrid.NestedStart(cycles=0)


def test_unheld_motion_is_refused_before_any_work(solved):
    grids, _ = solved["coulomb 1"]
    discrete = grids.finest.discrete
    free = replace(discrete, fixed=np.zeros_like(discrete.fixed), law=am.Frictionless())
    with pytest.raises(ValueError, match="translation along x"):
        am.solve(free, am.SingleGrid())


def test_prescribed_displacements():
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3), domain=am.Rectangle(width=1.0, height=0.5),
        contact=am.Contact("bottom", am.GapFunction(lambda x: 0.002 * (x[:, 0] - 0.5) ** 2)), law=am.Coulomb(0.3),
        supports=(am.Support("top", x=0.0005, y=-0.001),))
    grids = am.Hierarchy.uniform(problem, divisions=((4, 2), (8, 4), (16, 8)))
    reference = am.solve(grids, am.ActiveSet(rtol=1e-12))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-10))
    assert energy_error(grids, result, reference) < 1e-9
    top = grids.finest.mesh.boundary_nodes("top")
    assert np.array_equal(result.displacement[top], np.tile([0.0005, -0.001], (len(top), 1)))
    assert (result.contact.state == am.OPEN).any()
    assert (result.contact.state == am.SLIP).any()
