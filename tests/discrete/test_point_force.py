"""Forces at points: beams and resultants in closed form, load paths, adaptive loops, refusals."""

import numpy as np
import pytest
from refused import refused

import adaptmg as am

LENGTH, HEIGHT, E, NU, FORCE = 8.0, 1.0, 1e9, 0.25, 1e4
STEEL = am.PlaneStress(young=E, poisson=NU)


def beam(turn, size, shift, *loads, **changes):
    """A cantilever that is turned (rad), scaled and shifted (m), and the map of its points."""
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def place(*point):
        return tuple((size * np.array(point) @ axes + shift).tolist())

    corners = [(0, 0), (LENGTH, 0), (LENGTH, HEIGHT), (0, HEIGHT)]
    arguments = {
        "material": STEEL,
        "domain": am.Polygon(
            vertices=[place(*corner) for corner in corners],
            boundaries=["under", "end", "top", "wall"],
        ),
        "loads": [
            am.PointForce(place(*point), tuple(np.array(force) @ axes), name=name)
            for name, point, force in loads
        ],
        "supports": am.Support("wall", x=0, y=0),
        "elements": "smoothed",
    }
    return am.ContactProblem(**arguments | changes), axes, place


@pytest.mark.parametrize(
    ("turn", "size", "shift"), [(0.0, 1.0, (0.0, 0.0)), (2.2, 3e-3, (0.4, -0.1))]
)
def test_a_cantilever_bends_as_timoshenko_says(turn, size, shift):
    tip = ("tip", (LENGTH, 0.37), (0.0, -FORCE))
    problem, axes, place = beam(turn, size, shift, tip)
    result = am.solve(
        am.Hierarchy.graded(problem, [0.4 * size, 0.2 * size]), am.ActiveSet(rtol=1e-10)
    )
    along, up = ((result.mesh.points - shift) @ axes.T / size).T
    middle = np.hypot(along - LENGTH / 2, up - HEIGHT / 2).argmin()
    x = along[middle]
    inertia, shear = HEIGHT**3 / 12, E / (2 + 2 * NU)
    bent = FORCE * x**2 * (3 * LENGTH - x) / (6 * E * inertia)
    sheared = FORCE * x / (5 / 6 * shear * HEIGHT)
    assert (result.displacement @ axes.T)[middle, 1] == pytest.approx(-bent - sheared, rel=0.02)
    wall = result.resultant("wall")
    force = -np.array(tip[2]) @ axes
    np.testing.assert_allclose(wall.force, force, atol=1e-8 * FORCE)
    arm = np.array(place(*tip[1]))
    balance = arm[0] * force[1] - arm[1] * force[0]
    assert wall.moment == pytest.approx(balance, abs=1e-8 * FORCE * LENGTH * size)
    assert result.certificate()["balance"].relative < 1e-8


def test_names_scale_forces_in_load_paths():
    tip = ("tip", (LENGTH, 0.5), (0.0, FORCE))
    pull = (None, (LENGTH / 2, HEIGHT), (2 * FORCE, 0.0))
    grids = am.Hierarchy.graded(beam(0.0, 1.0, (0.0, 0.0), tip, pull)[0], [0.5])
    path = am.LoadPath({"tip": [1, -2], "point (4, 1)": [3, 0]})
    for result, force in zip(am.solve_path(grids, path), [(-6, -1), (0, 2)], strict=True):
        np.testing.assert_allclose(
            result.resultant("wall").force, np.array(force) * FORCE, atol=1e-6 * FORCE
        )


@pytest.mark.parametrize("engine", [am.Remesh(), am.Bisect()])
@pytest.mark.parametrize("indicator", [am.Residual(), am.Recovery()])
def test_adapted_meshes_keep_the_node_and_leave_its_elements_out(engine, indicator):
    point = (LENGTH, 0.37)
    problem, *_ = beam(0.0, 1.0, (0.0, 0.0), ("tip", point, (0.0, -FORCE)), elements="linear")
    steps = list(am.adapt(problem, 0.5, engine=engine, indicator=indicator, max_nodes=900))
    for step in steps:
        mesh = step.hierarchy.finest.mesh
        (node,) = np.flatnonzero(np.linalg.norm(mesh.points - point, axis=1) < 1e-12)
        at = (mesh.elements == node).any(axis=1)
        assert not step.estimate.squares[at].any() and step.estimate.squares[~at].all()
    assert steps[-1].estimate.relative < 0.45 * steps[0].estimate.relative


@pytest.mark.parametrize(
    ("material", "domain"),
    [
        (am.Solid(young=E, poisson=NU), am.Box(width=1, depth=1, height=1)),
        (am.Axisymmetric(young=E, poisson=NU), am.Rectangle(width=1, height=1)),
    ],
)
def test_whole_forces_arrive_in_space_and_in_axisymmetry(material, domain):
    """In axisymmetry of the full circumference, or of a point of the axis."""
    dim = domain.dim
    loads = [
        am.PointForce((0.0,) * (dim - 1) + (1.0,), (0.0,) * (dim - 1) + (3.0,)),
        am.PointForce((1.0,) * dim, (0.0,) * (dim - 1) + (4.0,)),
    ]
    problem = am.ContactProblem(
        material=material,
        domain=domain,
        loads=loads,
        supports=am.Support("bottom", **dict.fromkeys("xyz"[:dim], 0.0)),
    )
    grids = am.Hierarchy.from_meshes(problem, [am.mesh.structured(domain, 3)])
    result = am.solve(grids, am.ActiveSet(rtol=1e-10))
    assert result.resultant("bottom").force[-1] == pytest.approx(-7.0, abs=1e-7)


def test_the_force_is_drawn_with_its_tail_where_it_pulls():
    problem, *_ = beam(0.0, 1.0, (0.0, 0.0), ("up", (4.0, 1.0), (0.0, 2e3)))
    axes = am.plot.problem(problem).axes[0]
    assert "force (0, 2) kN/m at point (4, 1)" in [
        text.get_text() for text in axes.get_legend().get_texts()
    ]
    (arrow,) = [one for one in axes.collections if type(one).__name__ == "Quiver"]
    np.testing.assert_allclose([arrow.X[0], arrow.Y[0]], [4.0, 1.0])


FLAT = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
test_refused = refused(
    (lambda: am.PointForce((0, 0), (1, 2, 3)), "as many entries as point, 2, got 3"),
    (lambda: am.PointForce((0, 0), (np.nan, 1)), "components must"),
    (
        lambda: beam(0, 1, (0, 0), loads=am.PointForce((0, 0, 0), (1, 1, 1))),
        "3 components in a 2D problem",
    ),
    (
        lambda: am.discrete.load_vector(FLAT, [am.PointForce((0.3, 0.4), (1, 1))]),
        "no node of the mesh lies there",
    ),
    (
        lambda: am.discrete.load_vector(FLAT, [am.PointForce((0, 0, 0), (1, 1, 1))]),
        "3 components on a 2D mesh",
    ),
    (
        lambda: beam(0, 1, (0, 0), loads=am.PointForce((0, 0), (1, 1), body="lid")),
        "body 'lid', used for a load, does not exist",
    ),
)
