"""Plane domains combined: areas add up, names stay, meshes fill them, arcs keep their nodes; what
is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from gmsh_file import write
from matplotlib.collections import PolyCollection
from refused import refused

import adaptmg as am

BLOCK = am.Rectangle(width=4.0, height=2.0)
PLATE = am.Cut(BLOCK, am.Circle((2.0, 1.0), 0.5, "hole"))
POSED = am.ContactProblem(
    material=am.PlaneStrain(young=2e11, poisson=0.3),
    law=am.Coulomb(0.3),
    domain=PLATE,
    contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
)


def regular(n: int, centre: tuple[float, float], turn: float) -> am.Polygon:
    angle = turn + 2 * np.pi * np.arange(n) / n
    corners = np.array(centre) + np.column_stack([np.cos(angle), np.sin(angle)])
    return am.Polygon(vertices=tuple(map(tuple, corners.tolist())), boundaries=("side",) * n)


@pytest.mark.parametrize("seed", range(6))
def test_areas_of_random_bodies_add_up(seed):
    rng = np.random.default_rng(seed)
    makers = (
        lambda c: regular(int(rng.integers(3, 8)), c, rng.uniform(0, 6)),
        lambda c: am.Circle(c, float(rng.uniform(0.6, 1.1))),
        lambda c: am.Rectangle(width=1.5, height=1.2, origin=(c[0] - 0.7, c[1] - 0.6)),
    )
    a, b = (
        makers[rng.integers(3)](tuple(rng.uniform(-0.3, 0.3, 2) + shift))
        for shift in (0.0, [0.7, 0.3])
    )
    area = [am.Fuse(domain, domain).outline.area for domain in (a, b)]
    both = am.Common(a, b).outline.area
    assert both > 0 and am.Fuse(a, b).outline.area == pytest.approx(sum(area) - both, rel=1e-12)
    try:
        assert am.Cut(a, b).outline.area == pytest.approx(area[0] - both, rel=1e-12)
    except ValueError as error:
        assert "pieces" in str(error)


def test_known_areas_and_names():
    lens = am.Common(am.Circle((0, 0), 1.0), am.Circle((1, 0), 1.0, "right"))
    assert lens.outline.area == pytest.approx(2 * math.pi / 3 - math.sqrt(3) / 2, rel=1e-14)
    assert set(lens.boundaries) == {"circle", "right"}
    assert am.Extrusion(lens, 1.0).boundaries == (*lens.boundaries, "bottom", "top")
    torus = am.mesh.graded(am.Revolution(am.Circle((2.0, 0.0), 1.0)), 0.5)
    assert 0.95 < torus.volumes.sum() / (4 * math.pi**2) < 1.0
    # edges that coincide, and tangents that go on
    half = am.Fuse(am.Rectangle(width=3, height=2), am.Circle((0, 1), 1.0, "l"))
    stadium = am.Fuse(half, am.Circle((3, 1), 1.0, "r"))
    assert stadium.outline.area == pytest.approx(6 + math.pi) and stadium.boundaries == (
        "bottom",
        "r",
        "top",
        "l",
    )
    assert PLATE.boundaries == (*BLOCK.boundaries, "hole") and PLATE.outline.area == pytest.approx(
        8 - math.pi / 4
    )
    notched = am.Cut(
        PLATE, am.Rectangle(width=1.0, height=0.5), rename={"b.top": "notch", "b.right": "notch"}
    )
    assert notched.outline.area == pytest.approx(7.5 - math.pi / 4)
    assert notched.boundaries == ("bottom", "right", "top", "left", "notch", "hole")
    assert am.Cut(PLATE, am.Circle((2.0, 1.0), 0.7, "larger")).boundaries[-1] == "larger"


test_refused = refused(
    (lambda: am.Cut(BLOCK, am.Rectangle(width=1, height=9, origin=(1, -1))), "2 pieces"),
    (lambda: am.Cut(am.Circle((0, 0), 1.0), am.Circle((0, 0), 2.0)), "nothing"),
    (lambda: am.Fuse(am.Circle((0, 0), 1.0), am.Circle((3, 0), 1.0)), "2 pieces"),
    (lambda: am.Cut(BLOCK, am.Circle((1.0, 0.25), 0.25)), "touch each other at the point"),
    (lambda: am.Cut(BLOCK, am.Ball((0, 0, 0), 1.0)), "a is 2D, b 3D"),
    (lambda: am.Moved(PLATE), "got a plane Cut"),
    (
        lambda: am.Hierarchy.uniform(POSED, (4, 8)),
        TypeError,
        r"Rectangle or a Box, .*Hierarchy\.graded",
    ),
    (lambda: am.Extrusion(PLATE, 1.0), "polygon has holes"),
    (lambda: am.Cut(BLOCK, am.Circle((2, 1), 0.5), rename={"hole": "x"}), "hole"),
    (
        lambda: am.Outline(
            vertices=((0, 0), (1, 0), (1, 1), (0.2, 0.2), (0.4, 0.2), (0.3, 0.4)),
            holes=(3,),
            boundaries=("a",) * 6,
        ),
        "clockwise",
    ),
)


def test_meshes_fill_the_body_and_nodes_stay_on_the_arc():
    mesh = am.mesh.graded(PLATE, 0.4, ("hole",), 4)
    assert mesh.boundaries == PLATE.boundaries and 0 < mesh.volumes.sum() - 8 + math.pi / 4 < 0.01
    finer = am.mesh.onto_domain(
        PLATE, am.mesh.bisect(mesh, np.ones(len(mesh.elements), dtype=bool))[0], mesh.n_nodes
    )
    for one in (mesh, finer):
        around = one.points[one.boundary_nodes("hole")] - [2.0, 1.0]
        np.testing.assert_allclose(np.linalg.norm(around, axis=1), 0.5, rtol=1e-14)
    both = am.Assembly(parts={"plate": PLATE, "pin": am.Circle((2.0, 1.0), 0.5, "rim")})
    assert am.mesh.graded(both, 0.4).bodies == ("plate", "pin") and "pin.rim" in both.boundaries


def test_a_gmsh_file_with_names_is_solved_and_drawn(tmp_path):
    path = write(tmp_path / "plate.msh", replace(am.mesh.graded(PLATE, 0.6), bodies=("plate",)))
    problem = replace(
        POSED,
        domain=None,
        material={"plate": POSED.material},
        loads=am.Pressure("top", 5e7),
        supports=(
            am.Symmetry("left"),
            am.Spring("hole", normal=1e9),
            am.PointSpring((0, 2), y=1e9),
        ),
    )
    grids = am.Hierarchy.from_meshes(problem, [path])
    assert am.solve(grids, am.ActiveSet()).resultant("contact").force[1] > 0
    legend = am.plot.problem(problem, mesh=grids.finest.mesh).axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()][:3] == [
        "symmetry: $u_n$ = 0 on 'left'",
        "springs normal 1 GN/m³ on 'hole'",
        "springs y 1 GN/m on 'point (0, 2)'",
    ]
    with pytest.raises(ValueError, match="no domain to draw: give mesh="):
        am.plot.problem(problem)


def test_a_hole_is_drawn_empty():
    axes = am.plot.problem(POSED).axes[0]
    corners = np.array([path.vertices[:3] for path in axes.findobj(PolyCollection)[0].get_paths()])
    area = 0.5 * np.linalg.det(corners[:, 1:] - corners[:, :1]).sum()
    assert area == pytest.approx(8 - math.pi / 4, rel=0.01)
