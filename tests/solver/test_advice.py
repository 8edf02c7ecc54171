"""Warnings on what exceeds the theory: each fires where it should, and none on any case; the
default of one mesh."""

import logging
import pickle
import time
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import bar_hierarchy, bar_on_block
from norms import distance

import adaptmg as am
from adaptmg._numba import compiling_seconds, kernel
from adaptmg.solver import outcome as solving
from adaptmg.solver import record


def bar(
    scale=1.0,
    young=1.3e11,
    poisson=0.2,
    material=am.PlaneStrain,
    pressure=1e7,
    above=0.0,
    divisions=(4, 8),
):
    """A bar over a plane, pressed on it from its top, which is held sideways."""
    problem = am.ContactProblem(
        domain=am.Rectangle(width=40e-3 * scale, height=40e-3 * scale),
        material=material(young=young, poisson=poisson),
        contact=am.Contact("bottom", am.Plane(point=(0.0, -above), normal=(0.0, 1.0))),
        law=am.Coulomb(0.2),
        loads=(am.Pressure("left", pressure),),
        supports=(am.Support("top", x=0.0, y=-1e-5),),
    )
    return am.Hierarchy.uniform(problem, divisions=divisions)


def warned(act):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        act()
    return caught


def test_a_contact_boundary_without_a_condition_is_warned_of():
    """Of three walls around a corner the short one has two nodes, which belong to the others."""
    domain = am.Polygon(
        vertices=((1, 0), (8, 0), (8, 8), (0, 8), (0, 1)),
        boundaries=("floor", "right", "top", "left", "corner"),
    )
    walls = {
        "floor": am.Plane((0, 0), (0, 1)),
        "left": am.Plane((0, 0), (1, 0)),
        "corner": am.Plane((0.5, 0.5), (1, 1)),
    }
    for order, loud in ((("floor", "left", "corner"), True), (("corner", "left", "floor"), False)):
        problem = am.ContactProblem(
            domain=domain,
            material=am.PlaneStrain(young=1e9, poisson=0.3),
            law=am.Frictionless(),
            contact=[am.Contact(name, walls[name]) for name in order],
            loads=[am.Pressure(name, 1e6) for name in ("right", "top")],
        )
        grids = am.Hierarchy.from_meshes(problem, [am.mesh.graded(domain, 1.5, ())])
        texts = [str(one.message) for one in warned(lambda grids=grids: am.solve(grids))]
        assert ["'corner' has no condition" in text for text in texts] == [True] * loud


BEYOND = {
    'poisson is 0.46: give the problem elements="smoothed"': (
        {"poisson": 0.46},
        {"poisson": 0.45},
        {"poisson": 0.46, "material": am.PlaneStress},
    ),
    "span 40 m, with young .*1.3e\\+11 Pa.*in mm\\?": (
        {"scale": 1e3},
        {"scale": 100},
        {"scale": 1e3, "young": 1e9},
    ),
    "in mm and moduli in N/mm": (
        {"scale": 1e3, "young": 1.3e5, "pressure": 1e2},
        {"young": 1.3e5, "pressure": 1e2},
    ),
    "strains exceed 5 % in [\\d.]+ % of .*young \\(1e\\+06 Pa": ({"young": 1e6}, {"young": 1.3e9}),
    "stays at least .* they cannot meet": ({"above": 1e-3}, {"above": 5e-5}),
}


def test_a_mesh_that_is_not_one_of_the_domain_is_named():
    problem = am.cases.greco_bar()
    mesh = am.mesh.structured(problem.domain, 4)
    for points, wrong in (
        (mesh.points, False),
        (1e3 * mesh.points, True),
        (mesh.points + np.array([0.0, 0.02]), True),
    ):
        caught = warned(
            lambda points=points: am.Hierarchy.from_meshes(problem, replace(mesh, points=points))
        )
        assert ["spans" in str(one.message) and one.filename == __file__ for one in caught] == [
            True
        ] * wrong


@pytest.mark.parametrize("message", BEYOND)
def test_a_limit_of_the_theory_is_named_once_at_the_users_line(message):
    beyond, *within = BEYOND[message]
    grids = bar(**beyond)
    for act in (
        lambda: am.solve(grids),
        lambda: am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]})),
    ):
        with pytest.warns(UserWarning, match=message) as caught:
            act()
        assert len(caught) == 1 and caught[0].filename == __file__
    for one in within:
        assert not warned(lambda one=one: am.solve(bar(**one)))


def rubbed(law):
    """A block pressed on a dome, of which a part touches, and moved along it."""
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.04, height=0.02, origin=(-0.02, 0.0)),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        contact=am.Contact("bottom", am.GapFunction(lambda x: x[:, 0] ** 2 / 2)),
        law=law,
        supports=am.Support("top", x=2e-6, y=-1e-5),
    )
    return am.Hierarchy.uniform(problem, divisions=[(16, 8), (32, 16)])


#: the limit in Pa, and laws that have it in contact only
LIMIT = 2e7
IN_CONTACT = {
    "function of position": am.Tresca(lambda x: LIMIT * (np.abs(x[:, 0]) < 3e-3)),
    "StateLaw": am.StateLaw(lambda p, s: LIMIT / np.maximum(p, 1e5)),
    "Coulomb": am.Coulomb(0.1),
}


def test_friction_without_contact_is_named():
    """Tresca's limit holds at open nodes, too, which carry most of the friction of a small patch."""
    with pytest.warns(
        UserWarning, match="'bottom': its open nodes carry .* N/m of friction"
    ) as caught:
        result = am.solve(rubbed(am.Tresca(LIMIT)))
    assert len(caught) == 1 and caught[0].filename == __file__
    contact = result.contact
    open_nodes = contact.state == am.OPEN
    friction = np.abs(contact.force_t[:, 0])
    assert friction[open_nodes].sum() > friction[~open_nodes].sum()


@pytest.mark.parametrize("name", IN_CONTACT)
def test_friction_in_contact_is_not_warned_of(name):
    """A friction that does not rise with the pressure has one solution, however large the
    coefficient."""
    grids = rubbed(IN_CONTACT[name])
    results = []
    assert not warned(lambda: results.append(am.solve(grids)))
    contact = results[0].contact
    friction = np.abs(contact.force_t)
    assert friction[contact.state == am.OPEN].sum() < 1e-6 * friction.sum()
    if name == "StateLaw":
        traction = np.abs(contact.traction[contact.state == am.SLIP])
        assert len(traction) and np.allclose(traction, LIMIT, rtol=1e-4)


def test_large_strains_count_from_a_hundredth_of_a_body_on():
    """They fall like 1 / young, which gives the stiffness at which a number of elements exceeds 5 %."""

    def solved(young):
        grids = bar(young=young)
        held = replace(grids.problem, supports=am.Support("top", x=0.0, y=0.0))
        return am.solve(grids.with_problem(held))

    result = solved(1.3e11)
    corners, moved = (
        values[result.mesh.elements] for values in (result.mesh.points, result.displacement)
    )
    gradient = np.linalg.solve(corners[:, 1:] - corners[:, :1], moved[:, 1:] - moved[:, :1])
    strains = 0.5 * (gradient + gradient.swapaxes(1, 2))
    sizes = np.sort(np.linalg.norm(strains, ord=2, axis=(1, 2)))[::-1]
    few = len(sizes) // 100
    for beyond in (few, few + 1):
        young = 1.3e11 * sizes[beyond - 1 : beyond + 1].mean() / 0.05
        assert len(warned(lambda young=young: solved(young))) == (beyond > few)


def test_slips_beyond_an_element_count_between_bodies_alone():
    def pushed(by):
        problem = bar_on_block(am.Coulomb(0.1))
        first, *others = problem.supports
        return bar_hierarchy(replace(problem, supports=(replace(first, x=by), *others)), 2)

    assert not warned(lambda: am.solve(pushed(1e-5)))
    with pytest.warns(
        UserWarning, match="the larger of an element and 1% of the boundary.*small slips"
    ):
        am.solve(pushed(15e-3), throw=False)
    # a plane is the same everywhere, also after a motion
    problem = bar().problem
    raised = am.Moving(problem.contact[0].obstacle, displacement=(0.0, 1e-6))
    problem = replace(
        problem,
        contact=am.Contact("bottom", am.Moving(raised, displacement=(0.0, 0.0))),
        supports=am.Support("top", x=15e-3, y=0.0),
    )
    assert not warned(lambda: am.solve(am.Hierarchy.uniform(problem, divisions=(4, 8))))


def test_an_adaptive_loop_warns_once():
    soft = replace(bar().problem, material=am.PlaneStrain(young=1.3e8, poisson=0.495))
    caught = warned(lambda: list(am.adapt(soft, max_nodes=400)))
    assert sorted(str(one.message).split()[0] for one in caught) == ["material", "strains"]
    assert {one.filename for one in caught} == {__file__}


def test_one_mesh_takes_the_quickest_method_but_a_named_one(tmp_path):
    grids = bar(divisions=(21,))
    result = am.solve(grids)
    assert result.solver_name.startswith(
        "ActiveSet("
    ) and "the quickest is the active set method" in repr(result)
    assert am.solve(grids.finest.discrete).choice == result.choice
    result.save(tmp_path / "bar.npz")
    assert am.Result.load(tmp_path / "bar.npz").choice == result.choice
    # factors of many dofs in space are slow
    solid = am.Hierarchy.uniform(am.cases.greco_block(), (13,))
    large = am.solve(solid)
    assert large.solver_name == "Multigrid()"
    assert "coarse spaces" in repr(large) and len(large.levels) > 1
    assert large.mesh is solid.finest.mesh and "transfer" in large.timings
    expected = am.solve(solid, am.ActiveSet()).displacement
    assert large.displacement == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())
    pair = bar_hierarchy(bar_on_block(am.Coulomb(0.3)), 3).truncated(coarsest=2)
    assert (
        am.solve(pair).status.ok
        and am.solve_path(pair, am.LoadPath({"upper.left": [0.5, 1.0]})).complete
    )
    given = am.solve(grids, am.SingleGrid(rtol=1e-3))
    assert (
        given.solver_name == "SingleGrid(rtol=0.001)"
        and given.choice == ""
        and "solver=None" not in repr(given)
    )


@pytest.mark.parametrize("divisions", [(2, 4, 8), (4, 8, 16)])
def test_a_small_problem_takes_its_finest_level_alone(divisions):
    """Coarser levels are discretised when they are read, and are those of a hierarchy of meshes."""
    discretised = []

    def gap(points):
        discretised.append(len(points) - 1)
        return 1e-6 * np.cos(100 * points[:, 0]) ** 2

    bottom = am.Contact("bottom", am.GapFunction(gap))
    problem = replace(am.cases.greco_bar(), contact=bottom, reference={})
    grids = am.Hierarchy.uniform(problem, divisions)
    result = am.solve(grids)
    assert set(discretised) == {divisions[-1]}
    assert result.solver_name.startswith("ActiveSet(") and result.choice in str(result)
    assert [row["nodes"] for row in result.levels] == [grids.finest.n_nodes]
    assert "mesh" in grids.timings and "mesh" not in result.timings
    assert am.solve(grids, rtol=1e-4).rtol == 1e-4
    on_all_levels = am.solve(grids, am.FullMultigrid())
    assert set(discretised) == set(divisions)
    assert on_all_levels.choice == "" and len(on_all_levels.levels) == len(divisions)
    discrete = grids.finest.discrete
    assert distance(discrete, result.displacement, on_all_levels.displacement) < 2e-8
    of_meshes = am.Hierarchy.from_meshes(
        problem, [level.mesh for level in grids.levels], am.Interpolation()
    )
    assert grids.table() == of_meshes.table() == on_all_levels.levels
    for level, other in zip(grids.levels[1:], of_meshes.levels[1:], strict=True):
        assert abs(level.prolongation - other.prolongation).max() == 0
    sent = pickle.loads(pickle.dumps(am.Hierarchy.uniform(am.cases.greco_bar(), divisions)))
    assert sent.table() == grids.table()


def test_a_warning_names_the_default_tolerance_of_a_small_slender_bar():
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1000.0, height=1.0),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        loads=(am.Traction("top", (0.0, -1e-3)),),
        supports=(am.Support("left", x=0, y=0),),
    )
    meshes = [am.mesh.structured(problem.domain, cells) for cells in ((35, 1), (70, 2))]
    with pytest.warns(UserWarning, match="^the default rtol=1e-08 is below"):
        am.solve(am.Hierarchy.from_meshes(problem, meshes))


def test_larger_problems_pressures_and_paths_take_multigrid():
    larger = am.Hierarchy.uniform(am.cases.greco_bar(), (9, 18))
    rubber = replace(
        bar().problem, material=am.PlaneStrain(young=1e9, poisson=0.499), elements="smoothed"
    )
    for grids in (larger, am.Hierarchy.uniform(rubber, (4, 8))):
        assert am.solve(grids).solver_name == "FullMultigrid()"
    (step,) = am.solve_path(bar(), am.LoadPath({"left": [1.0]}))
    assert step.solver_name == "FullMultigrid()" and len(step.levels) == 2


@pytest.mark.parametrize("singular", [False, True])
def test_where_the_active_set_fails_multigrid_solves(monkeypatch, singular):
    run_active_set, run_multigrid = am.ActiveSet.run, am.FullMultigrid.run
    tries = []

    def fails(self, *arguments):
        tries.append(self)
        if singular:
            raise np.linalg.LinAlgError("singular matrix")
        return replace(run_active_set(self, *arguments), status=am.Status.CYCLING)

    monkeypatch.setattr(am.ActiveSet, "run", fails)
    grids = bar()
    result = am.solve(grids)
    assert result.status.ok and "FullMultigrid from cycle" in result.method
    assert (np.diff(result.history["cycle"]) >= 0).all()
    assert result.cycles == result.history["cycle"][-1] and result.levels == grids.table()
    alone = am.solve(grids, am.FullMultigrid())
    assert result.start_work_units == pytest.approx(alone.start_work_units)

    def fails_too(*arguments):
        if singular:
            raise np.linalg.LinAlgError("singular matrix")
        return replace(run_multigrid(*arguments), status=am.Status.STALLED, left=50)

    monkeypatch.setattr(am.FullMultigrid, "run", fails_too)
    tries.clear()
    result = am.solve(grids, throw=False)
    if singular:  # what has failed is not tried again
        assert not result.status.ok and len(tries) == 1
    else:  # the monotone correction goes on, on all levels
        assert result.status.ok and "Monotone from cycle" in result.method


@pytest.mark.parametrize(
    ("divisions", "large", "method", "levels"),
    [
        ((2, 3, 4, 8), 80, "FullMultigrid()", 3),
        ((4, 5, 6), 300, "ActiveSet(", 3),
        ((2, 4, 8), 80, "FullMultigrid()", 3),
    ],
)
def test_a_default_takes_the_levels_that_pay(monkeypatch, divisions, large, method, levels):
    monkeypatch.setattr(solving, "LARGE_COARSEST", large)
    grids = am.Hierarchy.uniform(am.cases.greco_block(), divisions=divisions)
    every, result = am.solve(grids, am.FullMultigrid()), am.solve(grids)
    assert every.choice == "" and len(every.levels) == len(divisions)
    assert result.solver_name.startswith(method) and len(result.levels) == levels
    assert bool(result.choice) is (divisions != (2, 4, 8)) and result.choice in str(result)
    assert "mesh" in grids.timings and "mesh" not in result.timings
    assert result.displacement == pytest.approx(
        every.displacement, abs=1e-6 * np.abs(every.displacement).max()
    )


def test_seconds_of_compiling_are_counted_apart():
    @kernel(cache=False)
    def once(a):
        return a + 1.0

    run, before, begin = record.Run(unit=1), compiling_seconds(), time.perf_counter()
    with run.phase("setup"), run.phase("cycles"):
        once(1.0)
    passed = time.perf_counter() - begin
    assert run.timings["compiling"] == compiling_seconds() - before > 0
    assert sum(run.timings.values()) <= passed


def test_progress_and_log_have_a_line_a_cycle_mesh_and_step(capsys, caplog):
    grids = bar()
    with caplog.at_level(logging.DEBUG, "adaptmg"):
        result = am.solve(grids, am.FullMultigrid(), progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(result.history["cycle"]) and lines[0].startswith("cycle 0: 1.")
    records = [
        (one.levelno, one.getMessage())
        for one in caplog.records
        if one.name == "adaptmg.solver.solve"
    ]
    assert [text for level, text in records if level == logging.INFO] == [
        text for level, text in records if "CONVERGED after" in text
    ]
    assert set(lines) < {text for _, text in records}
    steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}), progress=True)
    written = [line.partition("=")[0] for line in capsys.readouterr().err.splitlines()]
    assert written == [f"step {k} of 2 (left" for k in (0, 1)]
    assert steps.complete
    meshes = list(am.adapt(grids.problem, max_nodes=300, progress=True))
    assert len(capsys.readouterr().err.splitlines()) == 2 * len(meshes)
    for call in (
        lambda: am.solve(grids, progress=1),
        lambda: am.adapt(grids.problem, progress="bar"),
    ):
        with pytest.raises(TypeError, match="progress must be"):
            call()


@pytest.mark.parametrize(
    "case", [am.cases.hertz_cylinder, am.cases.hertz_sphere, am.cases.cattaneo]
)
def test_a_result_says_that_few_nodes_touch_and_the_size_that_helps(case):
    """A patch that grows less than it is shown; the default meshes of the cases are fine enough."""
    problem = case()
    a = problem.reference["half_width"]
    near = am.SizeNear([(0.0, 0.0)], size=a / 3, radius=1.5 * a, grading=0.9)
    result = am.solve(
        am.Hierarchy.from_meshes(problem, [am.mesh.sized(problem.domain, near, 0.02)])
    )
    touching = int((result.contact.state != am.OPEN).sum())
    (line,) = result.advice
    assert f"'upper.contact': {touching} nodes touch" in line and line in str(result)
    size = float(line.split("at most ")[1].split()[0])
    finer = am.mesh.sized(problem.domain, near.scaled(size / near.size), 0.02)
    assert not am.solve(am.Hierarchy.from_meshes(problem, [finer])).advice
    assert not am.solve(am.Hierarchy.graded(problem)).advice


def test_contact_that_fills_its_boundary_needs_no_more_nodes():
    whole = bar(pressure=0.0)
    assert not am.solve(whole).advice and (am.solve(whole).contact.state != am.OPEN).all()
    corner = am.cases.hertz_sphere(dim=3)
    (line,) = am.solve(am.Hierarchy.graded(corner, contact_ratio=20)).advice
    # on a quarter of a disc a node has the area of two equilateral triangles
    size = corner.reference["half_width"] * np.sqrt(np.pi / 4 / 60 / np.sqrt(0.75))
    assert "need 60" in line
    assert float(line.split("at most ")[1].split()[0]) == pytest.approx(size, rel=0.4)
    mesh = am.Hierarchy.graded(corner).finest.mesh
    radius = np.linalg.norm(mesh.points[mesh.boundary_nodes("upper.contact"), :2], axis=1)
    assert np.count_nonzero(radius < corner.reference["half_width"]) >= 60


@pytest.mark.parametrize(("angle", "warns"), [(0.4, True), (0.25, False)])
def test_a_result_says_that_a_body_turns_far(angle, warns, recwarn):
    """A plate that its supports turn about a corner: 23 and 14 degrees without a strain."""
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.1, height=0.3, origin=(0.3, -0.2)),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        contact=am.Contact("bottom", am.Plane((0, -9.0), (0, 1))),
        law=am.Frictionless(),
        supports=[
            am.PointSupport((0.3, -0.2), x=0.0, y=0.0),
            am.PointSupport((0.4, -0.2), y=0.1 * angle),
        ],
    )
    result = am.solve(am.Hierarchy.graded(problem, sizes=(0.05,), contact_ratio=1))
    far = [str(one.message) for one in recwarn if "turns by" in str(one.message)]
    assert bool(far) is warns and np.abs(result.stress()).max() < 1e-6 * 1e9
    if warns:
        assert f"turns by {np.degrees(angle):.3g} degrees" in far[0]
