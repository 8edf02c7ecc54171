"""Bodies in time, against closed forms, in any position and of any kind."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
from bodies import rotation, turned
from refused import check_refused

import adaptmg as am

# the published numbers of the bar are those of large strains
pytestmark = pytest.mark.filterwarnings("ignore:strains exceed")
KINDS = ("plane", "axisymmetric", "solid")


def bar(kind, divisions, **options):
    """Grids of the bar of the cases, a cylinder or a prism, turned at random, and the direction in
    which it flies."""
    problem = am.cases.impact_bar(**options)
    dim = 3 if kind == "solid" else 2
    rng = np.random.default_rng(42)
    turn = {"plane": rng.uniform(0, 6), "axisymmetric": 0.0, "solid": rng.uniform(-2, 2, 3)}[kind]
    material = problem.material
    domain = problem.domain
    if kind == "axisymmetric":
        material = am.Axisymmetric(young=material.young, poisson=0.0)
    if kind == "solid":
        material = am.Solid(young=material.young, poisson=0.0)
        domain = am.Box(width=domain.width, depth=domain.width, height=domain.height)
    down = rotation(turn) @ -np.eye(dim)[-1]
    wall = am.Plane(point=down * problem.contact[0].obstacle.point[1] * -1, normal=-down)
    meshes = [turned(am.mesh.structured(domain, n), turn) for n in divisions]
    contact = am.Contact("bottom", wall)
    problem = replace(problem, material=material, domain=None, contact=contact)
    return am.Hierarchy.from_meshes(problem, meshes), down


def total(result):
    return sum(result.energies.values())


def mechanical(result):
    return sum(result.energies[name] for name in ("kinetic", "strain", "load"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_bar_that_hits_a_wall(kind):
    # Doyen, Ern, Piperno 2011
    n = 40
    divisions = ((1, 1, 20), (2, 2, 40)) if kind == "solid" else ((1, 20), (2, 40))
    grids, down = bar(kind, divisions, gap=1.0)
    reference = grids.problem.reference
    begin = reference["begin"]
    step = 10.0 / n / reference["wave_speed"]
    dynamics = am.Dynamics(density=1.0, initial_velocity=10 * down, step=step, end=begin + 1.0)
    forces, times, energies = [], [], []
    for result in am.march(grids, dynamics, rtol=1e-12, certify_every=50):
        forces.append(-result.resultant("contact").force @ down)
        times.append(result.time - 0.5 * step)
        energies.append(mechanical(result))
        assert total(result) == pytest.approx(energies[0], rel=1e-6)
    forces, times = np.array(forces), np.array(times)
    expected = reference["force"] * (np.pi if kind == "axisymmetric" else 1.0)
    pressed = forces[(times > begin + 0.1) & (times < begin + 0.55)]
    assert abs(pressed.mean() / expected - 1) < 0.01
    assert pressed.std() < 0.01 * expected
    contact = times[forces > 0.5 * expected]
    np.testing.assert_allclose(contact[[0, -1]], [begin, reference["end"]], atol=3 * step)
    assert np.diff(energies).max() < 1e-10 * energies[0]
    assert energies[-1] > 0.97 * energies[0]
    assert np.einsum("nd,d->n", result.velocity, down).mean() == pytest.approx(-10, rel=0.06)


# waves pass 18 cells in a step, or 6000, where rounding of forces is as large as the tolerance
@pytest.mark.parametrize(("young", "accuracy"), [(900.0, 1e-11), (1e8, 1e-6)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_free_flight_is_exact(kind, young, accuracy):
    divisions = ((1, 1, 10), (2, 2, 20)) if kind == "solid" else ((1, 10), (2, 20))
    grids, down = bar(kind, divisions, gap=1e5, young=young)
    across = np.random.default_rng(1).uniform(-1, 1, len(down))
    velocity = 100.0 * (down if kind == "axisymmetric" else across)
    dynamics = am.Dynamics(density=1.0, initial_velocity=velocity, step=0.3, end=15.0)
    *_, last = am.march(grids, dynamics, rtol=1e-12)
    distance = 15.0 * velocity
    assert np.abs(last.displacement - distance).max() < accuracy * np.linalg.norm(distance)
    assert last.energies["strain"] < 1e-12 * last.energies["kinetic"]
    assert last.time == pytest.approx(15.0)


def moving_block(turn, elements):
    """A block between oblique supports, the upper of which presses it, and springs, which weight and
    a push move on a rough floor."""
    turning = rotation(turn)
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e3, poisson=0.3),
        contact=am.Contact("bottom", am.Plane(turning @ (0.0, -0.002), turning @ (0.0, 1.0))),
        law=am.Coulomb(0.3),
        supports=[
            am.Symmetry("left"),
            am.Support("top", normal=-1e-3),
            am.Spring("right", normal=5.0, tangential=2.0),
        ],
        loads=[am.Pressure("right", 2.0), am.BodyForce(tuple(turning @ (0.0, -1.0)))],
        elements=elements,
    )
    square = am.Rectangle(width=1.0, height=1.0)
    meshes = [turned(am.mesh.structured(square, n), turn) for n in (4, 8)]
    grids = am.Hierarchy.from_meshes(problem, meshes)
    dynamics = am.Dynamics(
        density=1.0,
        initial_velocity=tuple(turning @ (0.1, -0.5)),
        step=0.004,
        end=0.2,
        damping=1e-4,
    )
    results = list(am.march(grids, dynamics, rtol=1e-11))
    energies = np.array([total(result) for result in results])
    assert np.ptp(energies) < 1e-8 * abs(energies).max()
    assert min(results[-1].energies[name] for name in ("friction", "contact", "damping")) > 0
    return results[-1].displacement @ turning, results[-1].reaction @ turning


@pytest.mark.parametrize("elements", ["linear", "smoothed"])
def test_motion_does_not_depend_on_the_axes(elements):
    for straight, oblique in zip(
        moving_block(0.0, elements), moving_block(0.9, elements), strict=True
    ):
        np.testing.assert_allclose(oblique, straight, atol=1e-7 * np.abs(straight).max())


def test_tied_halves_move_like_a_whole():
    problem = am.cases.impact_bar(gap=1.0)
    dynamics = am.Dynamics(density=1.0, initial_velocity=(0, -10), step=0.01, end=0.2)
    parts = {
        name: am.Rectangle(width=1, height=5, origin=(0, y))
        for name, y in (("lower", 0.0), ("upper", 5.0))
    }
    halves = replace(
        problem,
        domain=am.Assembly(parts=parts),
        contact=am.Contact("lower.bottom", problem.contact[0].obstacle),
        ties=am.Tied("upper.bottom", "lower.top"),
    )
    whole = am.Hierarchy.uniform(problem, ((1, 10), (2, 20)))
    tied = am.Hierarchy.uniform(halves, ((1, 5), (2, 10)))
    for results in zip(
        *(am.march(grids, dynamics, rtol=1e-11) for grids in (whole, tied)), strict=True
    ):
        forces = [result.resultant("contact").force for result in results]
        np.testing.assert_allclose(forces[1], forces[0], atol=1e-6)
        top = [result.probe([(0.5, 10.0)]) for result in results]
        np.testing.assert_allclose(top[1], top[0], atol=1e-9)


@pytest.mark.parametrize("cells", [(16, 4), (12, 3)], ids=["matching", "not matching"])
def test_equal_bars_exchange_their_velocities(cells):
    parts = {
        name: am.Rectangle(width=2, height=0.5, origin=(x, 0))
        for name, x in (("left", 0.0), ("right", 2.05))
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.PlaneStrain(young=100.0, poisson=0.0),
        contact=am.ContactPair("left.right", "right.left"),
        law=am.Frictionless(),
    )
    half = tuple(n // 2 for n in cells)
    grids = am.Hierarchy.uniform(
        problem, [{"left": (8, 2), "right": half}, {"left": (16, 4), "right": cells}]
    )
    dynamics = am.Dynamics(
        density={"left": 1.0, "right": 1.0},
        initial_velocity={"left": lambda x: np.tile((0.2, 0.0), (len(x), 1))},
        step=0.0125,
        end=0.8,
    )
    results = list(am.march(grids, dynamics, rtol=1e-12))
    energies = [mechanical(result) for result in results]
    assert np.diff(energies).max() < 1e-10 * energies[0]
    mesh = grids.finest.mesh
    velocities = results[-1].velocity[mesh.elements].mean(axis=1)
    for body, expected in enumerate(((0.0, 0.0), (0.2, 0.0))):
        mean = velocities[mesh.element_body == body].mean(axis=0)  # of equal elements
        np.testing.assert_allclose(mean, expected, atol=0.06 * 0.2)


# the work of friction is the kinetic energy: mu g s; with mu (1 - a s) of the distance s: mu g (s - a s^2 / 2)
@pytest.mark.parametrize(
    ("law", "distance"),
    [
        (am.Coulomb(0.3), 0.25 / (0.6 * 9.81)),
        (
            am.StateLaw(lambda _, slip: 0.3 * np.maximum(1 - 4 * slip, 0.0)),
            0.25 * (1 - (1 - 2 / (0.6 * 9.81)) ** 0.5),
        ),
    ],
    ids=["constant", "falling"],
)
def test_a_sliding_block_stops(law, distance):
    density = 2000.0
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.4, height=0.1),
        material=am.PlaneStrain(young=1e8, poisson=0.3),
        contact=am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1))),
        law=law,
        loads=[am.BodyForce((0.0, -density * 9.81))],
    )
    grids = am.Hierarchy.uniform(problem, ((8, 2), (16, 4)))
    rest = am.solve(grids)
    dynamics = am.Dynamics(
        density=density, initial_velocity=(0.5, 0.0), step=0.004, end=0.26, damping=1e-3
    )
    *_, last = am.march(grids, dynamics, start=rest)
    moved = (last.displacement - rest.displacement)[:, 0]
    np.testing.assert_allclose(moved, distance, rtol=0, atol=2e-4)
    assert last.energies["friction"] == pytest.approx(0.5 * density * 0.01, rel=1e-3)
    assert last.contact.counts()["stick"] == len(last.contact)


def test_energy_is_conserved_on_a_wider_floor_whose_nodes_take_over_parts_of_others():
    density = 2000.0
    floor = am.Rectangle(width=1.0, height=0.1, origin=(-0.33, -0.1))
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"block": am.Rectangle(width=0.4, height=0.1), "floor": floor}),
        material=am.PlaneStrain(young=1e8, poisson=0.3),
        contact=am.ContactPair("floor.top", "block.bottom"),
        law=am.Coulomb(0.3),
        loads=[am.BodyForce((0.0, -density * 9.81))],
        supports=[am.Support("floor.bottom", x=0.0, y=0.0)],
    )
    grids = am.Hierarchy.uniform(problem, [{"block": (4, 1), "floor": (22, 2)}])
    dynamics = am.Dynamics(
        density=density, initial_velocity={"block": (0.1, 0.0)}, step=0.001, end=0.005
    )
    results = list(am.march(grids, dynamics, start=am.solve(grids), rtol=1e-10))
    assert (results[0].contact.measures > results[0].contact.weights).any()
    assert results[-1].energies["friction"] > 0.1 * results[-1].energies["kinetic"]
    np.testing.assert_allclose([total(result) for result in results], total(results[0]), rtol=1e-8)


def test_an_interrupted_march_goes_on_with_the_same_bits(tmp_path):
    grids, down = bar("plane", ((1, 10), (2, 20)), gap=0.5)
    dynamics = am.Dynamics(density=1.0, initial_velocity=10 * down, step=0.01, end=0.2)
    whole = list(am.march(grids, dynamics))
    begun = am.march(grids, replace(dynamics, end=0.1), store=tmp_path)
    for _ in range(7):
        next(begun)
    resumed = list(am.march(grids, dynamics, store=tmp_path))
    assert len(resumed) == len(whole) == 20
    for one, other in zip(whole, resumed, strict=True):
        assert np.array_equal(one.displacement, other.displacement)
        assert np.array_equal(one.velocity, other.velocity)
        assert one.energies == other.energies
    loaded = am.Result.load(tmp_path / "step_0012.npz")
    assert loaded.time == whole[12].time and np.array_equal(loaded.velocity, whole[12].velocity)
    scale = am.plot.deformation(loaded, velocity=True).axes[1]
    assert scale.get_ylabel() == "velocity |v| [m/s]"
    am.export.vtk(loaded, tmp_path / "step.vtu")
    written = meshio.read(tmp_path / "step.vtu").point_data["velocity"]
    np.testing.assert_array_equal(written[:, :2], loaded.velocity)
    with pytest.raises(ValueError, match=r"another run: .*dynamics"):
        am.march(grids, replace(dynamics, step=0.02), store=tmp_path)


def test_what_does_not_move_is_refused():
    problem = am.cases.impact_bar()
    grids = am.Hierarchy.uniform(problem, ((1, 10),))
    dynamics = am.Dynamics(density=1.0, step=0.1, end=1.0)
    wall = problem.contact[0].obstacle

    def against(obstacle):
        return grids.with_problem(replace(problem, contact=am.Contact("bottom", obstacle)))

    def with_dynamics(**changes):
        return lambda: am.march(grids, replace(dynamics, **changes))

    compliant = am.Contact("bottom", wall, compliance=am.NormalCompliance(1e-3))
    rubber = replace(problem, material=am.PlaneStrain(young=1e6, poisson=0.49), elements="smoothed")
    held = replace(problem, supports=(am.Support("top", x=0.0, y=0.0),))
    of_as_many_nodes = am.solve(am.Hierarchy.uniform(held, ((10, 1),)))
    step = next(am.march(grids, dynamics))
    next(am.march(grids, dynamics, start=step.displacement))
    check_refused(
        *(
            (lambda posed=posed: am.march(posed, dynamics), words)
            for posed, words in (
                (grids.finest.discrete, "levels with meshes"),
                (against(am.Moving(wall, displacement=(0, 1))), "Rigid or Moving .* a ContactPair"),
                (against(am.Rigid(wall, force=(None, 1.0))), "Rigid or Moving .* a ContactPair"),
                (
                    grids.with_problem(replace(problem, contact=compliant)),
                    "no NormalCompliance: .* soft body",
                ),
                (grids.with_problem(rubber), "march cannot solve for smoothed"),
            )
        ),
        *(
            (lambda start=start: am.march(grids, dynamics, start=start), words)
            for start, words in (
                (np.tile((0.0, -5.5), (22, 1)), r"overlap by 0.5 m .*am\.solve"),
                (step, r"start must be at rest, got a step of a march"),
                (of_as_many_nodes, "start must be on the finest mesh, which has 22 nodes"),
            )
        ),
        (with_dynamics(density={"bar": 1.0}), "bodies of density must be .*'body'.*'bar'"),
        (with_dynamics(density={}), "density must be given for each body; the bodies are body"),
        (with_dynamics(initial_velocity=(1.0, 0.0, 0.0)), "initial_velocity of 'body'"),
        (
            with_dynamics(initial_velocity={"bar": (0.0, 1.0)}),
            "bodies of initial_velocity must be",
        ),
        (with_dynamics(density=0.0), "density"),
        (with_dynamics(step=-1.0), "step"),
        (with_dynamics(end=0.01), "end"),
        (with_dynamics(damping=np.nan), "damping"),
    )
    with pytest.raises(TypeError, match=r"am\.Dynamics"):
        am.march(grids, am.LoadPath())
