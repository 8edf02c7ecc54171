"""The residual estimate of scalar problems: against true errors, zero where the solution is exact, and
rates of the meshes that follow it."""

import numpy as np
import pytest
from bodies import rotation, turned

import adaptmg as am

#: barycentric coordinates of the middles of 36 equal parts of a triangle
PARTS = np.array([(3 * i + k, 3 * j + k) for i in range(6) for j in range(6) for k in (1, 2)]) / 18
PARTS = np.column_stack([1 - PARTS.sum(axis=1), PARTS])[PARTS.sum(axis=1) < 1]


def true_and_estimated(grids, gradient, conductivity=1.0):
    """Return nodes, the error in the energy norm by the means of 36 parts of each triangle, and the
    estimate over it."""
    result = am.solve(grids)
    corners = result.mesh.points[result.mesh.elements]
    u = result.displacement[result.mesh.elements, 0]
    slope = np.linalg.solve(corners[:, 1:] - corners[:, :1], (u[:, 1:] - u[:, :1])[..., None])
    points = np.einsum("qk,ekd->qed", PARTS, corners)
    missed = gradient(points.reshape(-1, 2)).reshape(points.shape) - slope[..., 0]
    square = conductivity * (missed**2).sum(axis=2).mean(axis=0) @ result.mesh.volumes
    estimate = am.Residual().indicate(grids, result).total
    return grids.finest.n_nodes, np.sqrt(square), estimate / np.sqrt(square)


@pytest.mark.parametrize(("size", "tension"), [(1.0, 1.0), (3e-3, 7.0)])
def test_the_estimate_follows_the_error_of_a_membrane_on_its_floor(size, tension):
    problem = am.cases.obstacle_problem(
        radius=size, tension=tension, load=tension / size, depth=0.1 * size
    )
    a = problem.reference["contact_radius"]

    def gradient(x):
        r = np.linalg.norm(x, axis=1)[:, None]
        return np.where(r > a, (1 - (a / r) ** 2) / (2 * size), 0.0) * x

    grids = am.Hierarchy.graded(problem, [h * size for h in (0.2, 0.1, 0.05, 0.025)])
    nodes, errors, ratios = np.transpose(
        [true_and_estimated(grids.truncated(finest=k), gradient, tension) for k in range(4)]
    )
    assert ratios.min() > 6.5 and ratios.max() < 7.3
    assert np.polyfit(np.log(nodes), np.log(errors), 1)[0] == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize(
    ("engine", "size", "shift", "turn"),
    [(am.Bisect(), 3e-3, 0.7 - 0.2j, 1.0), (am.Remesh(), 40.0, 0.0, np.exp(2.3j))],
    ids=["bisecting", "remeshing"],
)
def test_loops_reach_the_rate_of_smooth_solutions_at_a_corner(engine, size, shift, turn):
    """The harmonic function Re z^(2/3) on an L, over an obstacle that it lies on for |z| > 1, pressed
    by a load that acts there alone."""
    corners = shift + size * turn * np.array([0, 2, 2 + 2j, -2 + 2j, -2 - 2j, -2j])
    # the edges at the corner lie at 3/4 pi to both sides
    scale = np.exp(-0.75j * np.pi) / turn / size

    def place(x):
        return (x @ (1, 1j) - shift) * scale

    def solution(x):
        return (place(x) ** (2 / 3)).real

    def gradient(x):
        slope = 2 / 3 * place(x) ** (-1 / 3) * scale
        return np.column_stack([slope.real, -slope.imag])

    problem = am.ScalarProblem(
        domain=am.Polygon(
            vertices=np.column_stack([corners.real, corners.imag]), boundaries=("edge",) * 6
        ),
        load=lambda x: (np.abs(place(x)) > 1) * -1 / size**2,
        lower=lambda x: solution(x) - np.maximum(1 - np.abs(place(x)), 0) ** 2,
        value=solution,
    )
    steps = list(am.adapt(problem, 0.4 * size, engine=engine, max_nodes=4500))
    nodes, errors, ratios = np.transpose(
        [true_and_estimated(step.hierarchy, gradient) for step in steps[-3:]]
    )
    assert ratios.min() > 3 and ratios.max() < 3.5
    # on uniform meshes -1/3
    assert np.polyfit(np.log(nodes), np.log(errors), 1)[0] < -0.48


@pytest.mark.parametrize(
    ("domain", "divisions", "turn"),
    [
        (am.Rectangle(width=2.0, height=1.0), (8, 4), 0.7),
        (am.Box(width=2.0, depth=1.0, height=1.0), (8, 4, 4), (0.3, -0.8, 0.5)),
    ],
    ids=["2D", "3D"],
)
def test_what_an_obstacle_bears_is_not_an_error(domain, divisions, turn):
    """A membrane lies on all of a folded obstacle, which bears its load and a line load at the fold."""
    mesh = turned(am.mesh.structured(domain, divisions), turn)

    def along(x):
        return (x @ rotation(turn))[:, 0]

    def estimate(side, load, fold=1.0):
        limit = {"lower" if side > 0 else "upper": lambda x: -side * np.abs(along(x) - fold)}
        problem = am.ScalarProblem(
            load=load, value=next(iter(limit.values())), held=("left", "right"), **limit
        )
        grids = am.Hierarchy.from_meshes(problem, [mesh])
        return am.Residual().indicate(grids, am.solve(grids))

    for side in (1, -1):
        assert estimate(side, -side).relative < 1e-9
        # the slope of a unit is missed in a row of cells of a quarter
        assert 1 < estimate(side, -side, 1.125).total / 0.5 < 2
        # one of 8 rows is pulled on, but its nodes are pressed on by the cells around
        load = lambda x, s=side: s * np.where(np.abs(along(x) - 1.29) < 0.01, 1.0, -50.0)  # noqa: E731
        assert 0 < (estimate(side, load).squares > 1e-12).mean() <= 1 / 8


#: bodies of cells of equal sides in the plane and in space, divisions, and a turn
CELLS = {
    "2D": (am.Rectangle(width=1.0, height=0.5), (8, 4), 0.7),
    "3D": (am.Box(width=1.0, depth=0.5, height=0.5), (8, 4, 4), (0.3, -0.8, 0.5)),
}
SIDE = 0.125


def terms(cells, k, held=None, **functions):
    """Return the mesh and the terms of the estimate of a problem with the conductivity k, whose
    functions are given in coordinates along the cells."""
    domain, divisions, turn = CELLS[cells]
    mesh = turned(am.mesh.structured(domain, divisions), turn)
    parts = {name: lambda x, f=f: f(x @ rotation(turn)) for name, f in functions.items()}
    grids = am.Hierarchy.from_meshes(am.ScalarProblem(conductivity=k, held=held, **parts), [mesh])
    return mesh, am.Residual().indicate(grids, am.solve(grids)).terms


@pytest.mark.parametrize("cells", CELLS)
def test_fluxes_of_a_parabola_jump_between_cells_and_leave_at_the_free_end(cells):
    k, f = 3.0, 2.0
    mesh, found = terms(
        cells,
        k,
        held=("left", "bottom", "top") + ("front", "back") * (cells == "3D"),
        load=lambda x: np.full(len(x), f),
        value=lambda x: f / k * (x[:, 0] - 0.5 * x[:, 0] ** 2),
    )
    # seven planes inside, and the free end, whose flux is that of half a cell
    squares = SIDE * 0.5 ** (mesh.dim - 1) * (f * SIDE) ** 2 * (7 + 0.25) / k
    # in space the shares of the load at nodes of the free end differ
    assert found["flux jumps"] == pytest.approx(squares, rel=1e-9 if cells == "2D" else 3e-3)
    assert found["element residual"] == pytest.approx(
        f**2 / k * mesh.element_sizes**2 @ mesh.volumes
    )


@pytest.mark.parametrize("side", [1, -1], ids=["lower", "upper"])
@pytest.mark.parametrize("cells", CELLS)
def test_all_of_the_jump_at_the_end_of_full_contact_counts(cells, side):
    k, slope = 3.0, 2.0
    mesh, found = terms(
        cells,
        k,
        load=lambda x: np.where(x[:, 0] < 0.5, -side, 0.0),
        value=lambda x: -side * slope * np.maximum(x[:, 0] - 0.5, 0.0),
        # it bends away from the function
        **{"lower" if side > 0 else "upper": lambda x: -side * 9 * np.maximum(x[:, 0] - 0.5, 0.0)},
    )
    assert found["flux jumps"] == pytest.approx(SIDE * 0.5 ** (mesh.dim - 1) * k * slope**2)


@pytest.mark.parametrize("side", [1, -1], ids=["lower", "upper"])
@pytest.mark.parametrize(
    ("height", "load"), [(0.01, 0.0), (0.01, -5.0), (-0.01, -5.0)], ids=["open", "in", "off"]
)
@pytest.mark.parametrize("cells", CELLS)
def test_waves_of_the_obstacle_between_nodes_count_by_their_bubbles(cells, height, load, side):
    """The function is 1, and at nodes the obstacle touches it in contact, else it is off by .02; at the
    middles of all edges the obstacle penetrates it by ``height``."""
    k = 3.0

    def obstacle(x):
        wave = np.abs(np.sin(np.pi * x / SIDE)).max(axis=1).round(9)
        return 1 + side * (height * wave - (load == 0) * 0.02 * (1 - wave))

    mesh, found = terms(
        cells,
        k,
        load=lambda x: np.full(len(x), side * load),
        value=lambda x: np.ones(len(x)),
        **{"lower" if side > 0 else "upper": obstacle},
    )
    # integrals of squared gradients of the bubbles of all edges of a triangle, and of a tetrahedron
    integral = 8.0 if cells == "2D" else 4 * SIDE
    assert found["obstacle"] == pytest.approx(k * len(mesh.elements) * integral * height**2)
    others = [square for name, square in found.items() if name != "obstacle"]
    assert max(others) < 1e-12


def test_a_membrane_at_rest_on_an_obstacle_at_zero_up_to_rounding_has_no_error():
    for lower in (0.0, -1e-17):
        problem = am.ScalarProblem(domain=am.Rectangle(width=1, height=1), load=-1.0, lower=lower)
        grids = am.Hierarchy.uniform(problem, (2, 4))
        assert am.Residual().indicate(grids, am.solve(grids)).total < 1e-8


@pytest.mark.parametrize("side", [1, -1], ids=["lower", "upper"])
def test_pressure_next_to_gaps_counts_in_the_equation_and_as_complementarity(side):
    """A membrane of eight triangles lies at its only free node on the tip of an obstacle."""
    k, load, gap = 3.0, 5.0, 0.1
    problem = am.ScalarProblem(
        domain=am.Rectangle(width=1.0, height=1.0),
        conductivity=k,
        load=-side * load,
        **{
            "lower" if side > 0 else "upper": lambda x: (
                -side * 2 * gap * np.abs(x - 0.5).max(axis=1)
            )
        },
    )
    grids = am.Hierarchy.uniform(problem, (2,))
    mesh = grids.finest.mesh
    found = am.Residual().indicate(grids, am.solve(grids)).terms
    centre = np.flatnonzero(np.abs(mesh.points - 0.5).max(axis=1) < 1e-9)
    around = mesh.volumes[(mesh.elements == centre).any(axis=1)].sum()
    # over the triangles around the node integrals of its hat are 1/3, of the square 1/6 of the area
    assert found["complementarity"] == pytest.approx(load * gap * around / 6)
    square = load**2 * (1 - around / 2)
    assert found["element residual"] == pytest.approx(mesh.element_sizes[0] ** 2 / k * square)
    assert found["flux jumps"] == found["obstacle"] == 0.0
