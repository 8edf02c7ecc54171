"""transfer_state: integrals of the state, the same mesh, other meshes, refusals, stores."""

from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import shaken
from bodies import rotation, turned
from refused import check_refused

import adaptmg as am

E, NU, SIZE = 2e11, 0.3, 3e8
KINDS = {"plane": am.PlaneStrain, "axisymmetric": am.Axisymmetric, "solid": am.Solid}
TIGHT = am.ActiveSet(rtol=1e-10)


class Memory:
    """A user-defined material: Hooke's law, with a state that holds whatever it was given."""

    state_size = 2

    def __init__(self, elastic):
        self.elastic = elastic

    def response(self, strain, state):
        k = strain.shape[1]
        stiffness = 2 * self.elastic.shear_modulus * np.diag([1.0] * 3 + [0.5] * (k - 3))
        stiffness[:3, :3] += self.elastic.lame
        return strain @ stiffness, np.repeat(stiffness[None], len(strain), axis=0), state


def pressed(kind, angle=0.0, material=None, **changes):
    """A block between a support and a rough moving plane, turned by an angle in its first plane."""
    dim = 3 if kind == "solid" else 2
    turn = rotation(angle if dim == 2 else (0.0, 0.0, angle))
    down = turn[:, 1] * -1.0
    steel = am.Plastic(KINDS[kind](young=E, poisson=NU), yield_stress=SIZE, hardening=5e9)
    return am.ContactProblem(
        name="pressed",
        material=steel if material is None else material(KINDS[kind](young=E, poisson=NU)),
        contact=am.Contact(
            "top" if dim == 2 else "back",
            am.Moving(am.Plane(-0.5 * down, down), displacement=3e-3 * down, name="press"),
        ),
        law=am.Coulomb(0.2),
        supports=(
            am.Support("bottom" if dim == 2 else "front", normal=0.0),
            am.Support("left", normal=0.0),
            *([am.Support("bottom" if dim == 3 else "left", normal=0.0)] if dim == 3 else []),
        ),
        **changes,
    )


def blocks(kind, numbers, angle=0.0):
    """Shaken meshes of the block, each with its own nodes."""
    box = am.Box(width=1.0, depth=0.5, height=0.4)
    domain = box if kind == "solid" else am.Rectangle(width=1.0, height=0.5)
    turn = (0.0, 0.0, angle) if kind == "solid" else angle
    return [
        turned(shaken(am.mesh.structured(domain, n), 0.08 / n, seed), turn)
        for seed, n in enumerate(numbers)
    ]


@pytest.mark.parametrize("smoothed", ["linear", "smoothed"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_integrals_of_the_state_and_constants_stay(kind, smoothed):
    """Random states on meshes that are not nested, turned; a constant state is met exactly."""
    angle = 0.0 if kind == "axisymmetric" else 0.7
    old_mesh, new_mesh = blocks(kind, [3, 4] if kind == "solid" else [5, 8], angle)
    problem = pressed(kind, angle, Memory, elements=smoothed)
    old = am.Hierarchy.from_meshes(problem, [old_mesh])
    new = am.Hierarchy.from_meshes(problem, [new_mesh])
    result = am.solve_path(old, am.LoadPath({"press": [0.5]}), am.ActiveSet(rtol=1e-4))[-1]
    data = result.stress_data
    rng = np.random.default_rng(1)
    state = np.column_stack(
        [rng.random(len(data.plastic.state)), np.full(len(data.plastic.state), 0.3)]
    )
    strain = rng.random(data.plastic.strain.shape)
    held = replace(data.plastic, state=state, strain=strain, accumulated=strain[:, 0, 0])
    result = replace(result, stress_data=replace(data, plastic=held))
    # slips rise along the contact boundary
    along = rotation((0.0, 0.0, angle))[: old_mesh.dim, 0]
    slips = 1e-4 * (2 + result.contact.x @ along)
    result = replace(result, contact=replace(result.contact, accumulated_slip=slips))
    found = am.transfer_state(old, result, new)
    moved = found.contact
    np.testing.assert_allclose(moved.accumulated_slip, 1e-4 * (2 + moved.x @ along), rtol=1e-9)
    weights = [
        mesh.volumes * (mesh.points[mesh.elements, 0].mean(axis=1) if kind == "axisymmetric" else 1)
        for mesh in (old_mesh, new_mesh)
    ]
    np.testing.assert_allclose(
        np.tensordot(weights[1], found.plastic_strain, 1),
        np.tensordot(weights[0], strain, 1),
        rtol=1e-12,
    )
    if smoothed == "linear":
        integral = weights[1] @ found.stress_data.plastic.state[:, 0]
        assert integral == pytest.approx(weights[0] @ state[:, 0], rel=1e-12)
    np.testing.assert_allclose(found.stress_data.plastic.state[:, 1], 0.3, rtol=1e-14)
    same = am.transfer_state(old, result, old).stress_data.plastic
    np.testing.assert_allclose(same.state, state, rtol=1e-11)
    # of the plastic strain, too, all values lie between those of the old mesh
    assert strain.min() <= found.plastic_strain.min() <= found.plastic_strain.max() <= strain.max()


def test_slips_next_to_a_held_node_are_those_of_the_contact():
    """A node of the contact boundary that a support holds has no slip, and lessens none."""
    clamped = replace(
        pressed("plane"),
        contact=am.Contact("top", am.Plane((0.0, 0.5), (0.0, -1.0))),
        supports=am.Support("left", x=0.0, y=0.0),
        loads=am.Pressure("bottom", 1e6),
    )
    old, new = (am.Hierarchy.from_meshes(clamped, [mesh]) for mesh in blocks("plane", [5, 8]))
    result = am.solve_path(old, am.LoadPath({"bottom": [1.0]}), TIGHT)[-1]
    held = len(old.finest.mesh.boundary_nodes("top")) - len(result.contact)
    assert held == 1
    slips = np.full(len(result.contact), 0.3)
    result = replace(result, contact=replace(result.contact, accumulated_slip=slips))
    moved = am.transfer_state(old, result, new).contact.accumulated_slip
    np.testing.assert_allclose(moved, 0.3, rtol=1e-12)


def test_a_start_has_the_elements_of_the_mesh_and_its_slips_belong_to_nodes():
    """Not to rows of its contact, which may have had other boundaries."""
    problem = replace(pressed("plane"), law=am.Coulomb(0.1))
    wall = am.Contact("right", am.Plane((1.0005, 0.0), (-1.0, 0.0)))
    mesh = blocks("plane", [5])[0]
    path = am.LoadPath({"press": [0.5, 0.7]})
    posed = replace(problem, contact=(*problem.contact, wall))
    grids = am.Hierarchy.from_meshes(posed, [mesh])
    start = am.solve_path(grids, path, TIGHT)[0]
    slips = np.zeros(mesh.n_nodes)
    slips[start.contact.node] = start.contact.accumulated_slip
    without_wall = am.Hierarchy.from_meshes(problem, [mesh])
    first = am.solve_path(without_wall, path, TIGHT, start=start)[0].contact
    assert slips[first.node].max() > 1e-5
    assert (first.accumulated_slip >= slips[first.node]).all()
    numbers = np.random.default_rng(0).permutation(len(mesh.elements))
    other = am.Hierarchy.from_meshes(posed, [replace(mesh, elements=mesh.elements[numbers])])
    for refused in (
        lambda: am.solve_path(other, path, TIGHT, start=start),
        lambda: am.transfer_state(other, start, grids),
    ):
        with pytest.raises(ValueError, match="another mesh"):
            refused()


@pytest.mark.parametrize("elements", ["linear", "smoothed"])
def test_a_path_on_the_same_mesh_goes_on_as_if_nothing_had_happened(elements, tmp_path):
    """Turned, with friction; also from a file, and from a store that was interrupted."""
    problem = pressed("plane", 0.7, elements=elements)
    grids = am.Hierarchy.from_meshes(problem, blocks("plane", [4, 8], 0.7))
    whole = am.solve_path(grids, am.LoadPath({"press": [0.4, 0.8, 1.0, 0.2]}), TIGHT)
    start = am.transfer_state(grids, whole[1], grids)
    assert start.status is am.Status.TRANSFERRED
    assert "TRANSFERRED" in str(start)
    start.save(tmp_path / "start.npz")
    start = am.Result.load(tmp_path / "start.npz")
    assert start.accumulated_plastic_strain.max() > 1e-3
    np.testing.assert_allclose(
        start.contact.accumulated_slip, whole.slip_path()[1], rtol=1e-12, atol=1e-18
    )
    path = am.LoadPath({"press": [0.8, 1.0, 0.2]})
    rest = am.solve_path(grids, path, TIGHT, start=start)
    assert rest[0].cycles <= 3
    for one, other in zip(whole[1:], rest, strict=True):
        size = np.abs(one.displacement).max()
        np.testing.assert_allclose(other.displacement, one.displacement, atol=1e-8 * size)
        np.testing.assert_allclose(
            other.accumulated_plastic_strain, one.accumulated_plastic_strain, atol=1e-10
        )
        np.testing.assert_allclose(
            other.contact.accumulated_slip, one.contact.accumulated_slip, atol=1e-8 * size
        )
    store = tmp_path / "store"
    am.solve_path(grids, path, TIGHT, start=start, store=store)
    (store / "step_0002.npz").unlink()
    again = am.solve_path(grids, path, TIGHT, start=start, store=store)
    np.testing.assert_array_equal(again[-1].displacement, rest[-1].displacement)
    with pytest.raises(ValueError, match="start"):
        am.solve_path(grids, path, TIGHT, store=store)


@pytest.mark.slow
def test_forces_after_a_change_of_meshes_are_those_of_the_new_mesh():
    """Prandtl's punch: the force dips where the mesh changes, and is that of an uninterrupted run
    from the next step on."""
    problem = am.cases.prandtl_punch(elements="smoothed")
    old = am.Hierarchy.graded(problem, [8e-3, 4e-3, 2e-3], contact_ratio=8)
    new = am.Hierarchy.graded(problem, [7e-3, 3.6e-3, 1.8e-3], contact_ratio=8)
    factors = [0.2, 0.4, 0.5]
    solver = am.FullMultigrid(rtol=1e-6)

    def forces(results):
        return np.array([result.resultant("contact").force[1] for result in results])

    first = am.solve_path(old, am.LoadPath({"punch": factors[:2]}), solver)
    start = am.transfer_state(old, first[-1], new)
    rest = am.solve_path(new, am.LoadPath({"punch": factors[1:]}), solver, start=start)
    whole = am.solve_path(new, am.LoadPath({"punch": factors}), solver)
    missed = forces(rest) / forces(whole)[1:] - 1
    assert -0.05 < missed[0] < 0
    assert np.abs(missed[1:]).max() < 5e-4


def discs(names, size):
    """A disc with a user-defined material and an elastic one, each held at its circle."""
    parts = {
        "soft": am.Circle(centre=(0.1, 0.0), radius=0.1),
        "hard": am.Circle(centre=(0.31, 0.0), radius=0.1),
    }
    elastic = am.PlaneStrain(young=E, poisson=NU)
    problem = am.ContactProblem(
        name="discs",
        domain=am.Assembly(parts={name: parts[name] for name in names}),
        material={name: Memory(elastic) if name == "soft" else elastic for name in names},
        loads=am.BodyForce((0.0, 1e9)),
        supports=[am.Support(f"{name}.circle", x=0.0, y=0.0) for name in names],
    )
    return am.Hierarchy.graded(problem, [size])


def test_elements_outside_the_old_mesh_take_the_state_of_their_body():
    """Finer meshes stick out of coarse ones at an arc; bodies come in another order."""
    old = discs(("soft", "hard"), 0.05)
    new = discs(("hard", "soft"), 0.013)
    result = am.solve(old)
    data = result.stress_data
    state = np.full(data.plastic.state.shape, 0.3)
    held = replace(data.plastic, state=state, accumulated=(data.plastic.accumulated + 1.0))
    result = replace(result, stress_data=replace(data, plastic=held))
    found = am.transfer_state(old, result, new)
    assert new.finest.mesh.volumes.sum() > 1.02 * old.finest.mesh.volumes.sum()
    np.testing.assert_allclose(found.stress_data.plastic.state, 0.3, rtol=1e-14)
    below = result.von_mises().max(), result.displacement.max()
    assert found.von_mises().max() <= below[0] * (1 + 1e-12)
    assert 0.9 * below[1] < found.displacement.max() <= below[1]
    assert not found.plastic_strain[found.mesh.element_body == 0].any()
    alone = discs(("soft",), 0.05)
    with pytest.raises(ValueError, match="same bodies, got hard"):
        am.transfer_state(old, result, alone)


def test_a_billet_is_upset_on_three_meshes(tmp_path):
    """The forces are those of one fine mesh, below those of slabs; the middle bulges; a loop that
    was interrupted ends with the same bits."""
    problem = am.cases.upset_billet()
    path = am.LoadPath({"plate": np.arange(1, 7) / 6})
    options = {
        "indicator": am.Recovery(),
        "engine": am.Remesh(),
        "load_path": path,
        "remesh_every": 2,
        "max_nodes": 400,
        "solver": am.FullMultigrid(rtol=1e-6),
    }
    start = am.Hierarchy.graded(problem, [4e-3, 2e-3, 1e-3])
    steps = list(am.adapt(problem, start, store=tmp_path / "whole", **options))
    assert [len(step.path) for step in steps] == [2, 3, 3]
    assert "load path ends after 6" in steps[-1].outcome
    assert steps[0].nodes < steps[1].nodes < steps[2].nodes <= 400
    area = np.pi * problem.reference["radius"] ** 2

    def pressures(results):
        return np.array([-result.resultant("contact").force[1] / area for result in results])

    one = am.solve_path(am.Hierarchy.graded(problem, [4e-3, 2e-3, 8e-4]), path, options["solver"])
    exact = pressures(one)
    for k, step in enumerate(steps):
        found = pressures(step.path)
        np.testing.assert_allclose(found[-2:], exact[2 * k : 2 * k + 2], rtol=5e-4)
        if k:
            assert -0.06 < found[0] / exact[2 * k - 1] - 1 < 0  # the dip at the change
    slabs = problem.reference["pressure"]
    assert 0.98 * slabs < exact[-1] < slabs
    mesh = steps[-1].result.mesh
    side = steps[-1].result.displacement[mesh.surface("right").nodes, 0]
    height = mesh.points[mesh.surface("right").nodes, 1]
    assert side[height.argmin()] > 1.5 * side[height.argmax()] > 0
    loop = am.adapt(problem, start, store=tmp_path / "part", **options)
    next(loop)
    next(loop)
    loop.close()
    again = list(am.adapt(problem, start, store=tmp_path / "part", **options))
    np.testing.assert_array_equal(again[-1].result.displacement, steps[-1].result.displacement)


def test_elastic_bodies_with_friction_are_followed_on_several_meshes():
    """Loaded and unloaded: the slips that stay are those of one fine mesh."""
    problem = am.cases.greco_bar()
    path = am.LoadPath({"left": [0.5, 1.0, 0.5, 0.2]})
    start = am.mesh.structured(problem.domain, 6)
    steps = list(am.adapt(problem, start, load_path=path, remesh_every=2, max_nodes=400, rtol=1e-8))
    one = am.solve_path(steps[-1].hierarchy, path, rtol=1e-8)
    assert steps[0].nodes < steps[1].nodes
    for found, exact in zip(steps[-1].path[1:], one[2:], strict=True):
        force = exact.resultant("contact").force
        np.testing.assert_allclose(
            found.resultant("contact").force, force, atol=0.02 * np.abs(force).max()
        )


@pytest.mark.parametrize("engine", [am.Bisect(), am.Remesh()], ids=repr)
def test_meshes_along_a_path_may_have_as_many_nodes_or_fewer(engine, tmp_path):
    """The estimate changes from load step to load step, and the number of nodes is nearly used."""
    shear = am.Traction("top", (2e5, 0.0), name="shear")
    problem = replace(
        am.cases.greco_bar(law=am.Coulomb(0.3)), loads=(am.Pressure("top", 1e6), shear)
    )
    path = am.LoadPath({"shear": [0, 1, -0.5, 0.5, 0.9, 0.3]})
    options = {"load_path": path, "remesh_every": 1, "max_nodes": 130, "engine": engine}
    steps = list(am.adapt(problem, 8e-3, store=tmp_path, **options))
    nodes = np.array([step.nodes for step in steps])
    assert len(steps) == len(path) and (np.diff(nodes) <= 0).any() and (np.diff(nodes) > 0).any()
    again = list(am.adapt(problem, 8e-3, store=tmp_path, **options))
    assert [step.nodes for step in again] == nodes.tolist()
    for step in steps:
        sizes = [level.n_nodes for level in step.hierarchy]
        assert sizes == sorted(set(sizes))
    # forces on the last mesh balance the load
    forces = [steps[-1].result.resultant(name).force for name in ("contact", "right")]
    np.testing.assert_allclose(sum(forces), 0.04 * np.array([-0.3 * 2e5, 1e6]), atol=4.0)


def test_what_is_refused():
    plain = pressed("plane")
    meshes = blocks("plane", [3, 5])
    old = am.Hierarchy.from_meshes(plain, meshes[:1])
    new = am.Hierarchy.from_meshes(plain, meshes[1:])
    path = am.LoadPath({"press": [0.5]})
    result = am.solve_path(old, path, TIGHT)[-1]
    elastic = am.Hierarchy.from_meshes(
        replace(plain, material=am.PlaneStrain(young=E, poisson=NU)), meshes[1:]
    )
    other = am.Hierarchy.from_meshes(pressed("plane", material=Memory), meshes[1:])
    stressed = replace(plain, material=am.PlaneStress(young=E, poisson=NU))
    far = replace(meshes[1], points=meshes[1].points + 1.0)
    part = replace(meshes[1], points=meshes[1].points * 0.5)
    start = am.transfer_state(old, result, new)
    unmoved = am.transfer_state(old, result, old)
    options = {"indicator": am.Recovery(), "load_path": path}

    def moved(result, grids):
        return lambda: am.transfer_state(old, result, grids)

    def goes_on(grids, start):
        return lambda: am.solve_path(grids, path, TIGHT, start=start)

    def follows(**changed):
        return lambda: am.adapt(plain, meshes[0], **options | changed)

    check_refused(
        (lambda: am.transfer_state(new, result, old), "finest mesh of old_grids"),
        (moved(result, elastic), "states as in old_grids"),
        (moved(result, other), "of 5 numbers .* got 2"),
        (moved(replace(result, status=am.Status.LIMIT), new), "converged"),
        (moved(unmoved, new), "converged .* TRANSFERRED"),
        (moved(result, new.with_problem(stressed)), "of PlaneStrain, .* got PlaneStress"),
        (moved(result, am.Hierarchy.single(new.finest.discrete)), "new_grids must be"),
        (moved(result, am.Hierarchy.from_meshes(plain, [far])), "here coarse and fine"),
        (moved(result, am.Hierarchy.from_meshes(plain, [part])), "same body"),
        (goes_on(new, result), "carry it over"),
        (goes_on(elastic, start), r"states \(0, 0\)"),
        (goes_on(other, start), "states"),
        (goes_on(new, replace(start, motions={"press": [0.0]})), "motions"),
        (follows(load_path=None, remesh_every=1), "come with a load_path"),
        (follows(remesh_every=0), "remesh_every"),
        (follows(remesh_every=1, adapt_on="worst"), "adapt_on"),
        (follows(indicator=am.Residual()), "Recovery"),
    )
