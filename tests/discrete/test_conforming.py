"""Curved surfaces that fit each other, with edges that do not match: gaps are those of the exact
surfaces, chords notwithstanding."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from netgen import occ

import adaptmg as am

RADIUS, CLEARANCE = 0.1, 1e-5
#: of edges that are a third of the radius long, 140 clearances high
SIZES = {"inner": 0.031, "outer": 0.038}


def ball_in_shell(r, fit, place):
    shell = am.Cut(am.Ball(place, 1.5 * r), am.Ball(place, fit), rename={"b.surface": "hole"})
    return am.Ball(place, r), shell, "surface", "hole"


def pin_in_block(r, fit, place):
    pin, drill = (am.Cylinder(place, (0, 0, 1), radius, r) for radius in (r, fit))
    block = am.Box(
        width=3 * r, depth=3 * r, height=r, origin=np.add(place, (-1.5 * r, -1.5 * r, 0))
    )
    return pin, am.Cut(block, drill, rename={"b.side": "hole"}), "side", "hole"


def cone_in_seat(r, fit, place):
    reach = (fit - r) * np.sqrt(1.25)  # of a clearance along the normal of the cone
    cone = am.Polygon(
        vertices=((0, 0), (r / 2, 0), (r, r), (0, r)), boundaries=("rest", "side", "rest", "axis")
    )
    seat = am.Polygon(
        vertices=((r / 2 + reach, 0), (2 * r, 0), (2 * r, r), (r + reach, r)),
        boundaries=("rest", "rest", "rest", "hole"),
    )
    return am.Revolution(cone), am.Revolution(seat), "side", "hole"


def ring_in_groove(r, fit, place):
    centre, h = (3 * r, 0.0), r * np.sqrt(0.5)
    bead = am.Circle(centre, r, "side")
    groove = am.Outline(
        vertices=[(3 * r + x, z) for x, z in ((2 * r, -2 * r), (2 * r, 2 * r))]
        + [(3 * r + fit / r * x, fit / r * z) for x, z in ((h, h), (h, -h))],
        boundaries=("rest", "rest", "hole", "rest"),
        arcs={2: centre},
    )
    return am.Revolution(bead, 90), am.Revolution(groove, 90), "side", "hole"


def disc_in_plate(r, fit, place):
    plate = am.Circle(place[:2], 2 * r, "rest")
    return (
        am.Circle(place[:2], r),
        am.Cut(plate, am.Circle(place[:2], fit, "hole")),
        "circle",
        "hole",
    )


SHAPES = (ball_in_shell, pin_in_block, cone_in_seat, ring_in_groove, disc_in_plate)


def posed(domain, pair, material=None, **parts):
    kind = material or (am.Solid if domain.dim == 3 else am.PlaneStrain)
    return am.ContactProblem(
        domain=domain,
        material=kind(young=2e11, poisson=0.3),
        law=am.Frictionless(),
        contact=pair,
        **parts,
    )


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_gaps_are_between_the_exact_surfaces(shape):
    scale = 10 ** np.random.default_rng().uniform(-2, 2)
    r, clearance = scale * RADIUS, scale * CLEARANCE
    place = (scale, -0.3 * scale, 0.2 * scale)
    inner, outer, side, hole = shape(r, r + clearance, place)
    if inner.dim == 3:
        turned = np.random.default_rng()
        motion = {
            "offset": turned.normal(size=3),
            "angle": turned.uniform(0, 360),
            "axis": (1, 2, 3),
        }
        inner, outer = am.Moved(inner, **motion), am.Moved(outer, **motion)
    domain = am.Assembly(parts={"inner": inner, "outer": outer})
    mesh = am.mesh.graded(domain, {body: scale * size for body, size in SIZES.items()})
    for sides in ((f"inner.{side}", f"outer.{hole}"), (f"outer.{hole}", f"inner.{side}")):
        contact = am.discretise(posed(domain, am.ContactPair(*sides)), mesh).contact
        # along mean normals of facets, which lean where a boundary ends
        assert contact.gaps.min() > 0.97 * clearance
        assert np.median(contact.gaps) == pytest.approx(clearance, rel=0.02)


def twice_bisected(mesh):
    """The mesh, bisected twice at random without its domain: new nodes lie on chords."""
    for _ in range(2):
        chosen = np.random.default_rng().random(len(mesh.elements)) < 0.5
        mesh = am.mesh.bisect(mesh, chosen)[0]
    return mesh


def middle_gap(domain, pair, mesh):
    return np.median(am.discretise(posed(domain, am.ContactPair(*pair)), mesh).contact.gaps)


@pytest.mark.parametrize("shape", [pin_in_block, disc_in_plate])
def test_gaps_stay_exact_where_bisection_leaves_nodes_on_chords(shape):
    inner, outer, side, hole = shape(RADIUS, RADIUS + CLEARANCE, (0, 0, 0))
    domain = am.Assembly(parts={"inner": inner, "outer": outer})
    mesh = twice_bisected(am.mesh.graded(domain, SIZES))
    gap = middle_gap(domain, (f"outer.{hole}", f"inner.{side}"), mesh)
    assert gap == pytest.approx(CLEARANCE, rel=0.03)


def test_a_mesh_that_was_moved_keeps_its_own_gaps():
    inner, outer, side, hole = disc_in_plate(RADIUS, RADIUS + CLEARANCE, (0, 0, 0))
    domain = am.Assembly(parts={"inner": inner, "outer": outer})
    mesh = am.mesh.graded(domain, SIZES)
    points = mesh.points.copy()
    points[mesh.elements[mesh.element_body == 0]] += [0.02, 0.0]
    pair = am.ContactPair(f"inner.{side}", f"outer.{hole}", allow_interference=True)
    gaps = am.discretise(posed(domain, pair), replace(mesh, points=points)).contact.gaps
    assert gaps.min() < -0.015 and gaps.max() > 0.015


def test_gaps_between_faces_of_a_step_file_are_exact(tmp_path):
    fit = RADIUS + CLEARANCE
    pin, drill = (occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 1e3 * r, 80) for r in (RADIUS, fit))
    block = occ.Box(occ.Pnt(-150, -150, 0), occ.Pnt(150, 150, 80)) - drill
    pin.name, block.name = "pin", "block"
    axis = occ.Axis((0, 0, 0), occ.Vec(1, 2, 3))
    parts = [solid.Rotate(axis, 40).Move(occ.Vec(300, 20, -500)) for solid in (pin, block)]
    occ.Compound(parts).WriteStep(str(path := tmp_path / "pin.step"))
    faces = am.mesh.step_table(path)
    round_ones = faces[faces.kind == "cylinder"]
    pair = [f"{row.solid}.{row.face}" for row in round_ones.itertuples()]
    domain = am.StepFile(path)
    mesh = am.mesh.graded(domain, {"pin": 0.035, "block": 0.045})
    assert middle_gap(domain, pair, mesh) == pytest.approx(CLEARANCE, rel=0.02)
    # a mesh outlives its file: chords again
    path.unlink()
    problem = posed(domain, am.ContactPair(*pair, allow_interference=True))
    assert am.discretise(problem, mesh).contact.gaps.min() < -10 * CLEARANCE


def ring(a, b, names):
    return am.Cut(am.Circle((0, 0), b, names[1]), am.Circle((0, 0), a, names[0]))


def pin_in_bush(clearance, down):
    """A stiff pin, moved down in its soft bush."""
    domain = am.Assembly(
        parts={
            "pin": ring(0.5 * RADIUS, RADIUS, ("core", "rim")),
            "bush": ring(RADIUS + clearance, 2 * RADIUS, ("hole", "rest")),
        }
    )
    return replace(
        posed(domain, am.ContactPair("bush.hole", "pin.rim")),
        material={name: am.PlaneStrain(young=young, poisson=0.3) for name, young in MODULI.items()},
        supports=(am.Support("pin.core", x=0, y=-down), am.Support("bush.rest", x=0, y=0)),
    )


MODULI = {"pin": 2e11, "bush": 2e9}


def on_mesh(problem, mesh):
    return am.solve(am.Hierarchy.from_meshes(problem, [mesh]), am.ActiveSet(rtol=1e-6))


@cache
def fine_peak(clearance):
    """Return the peak of the pressure on a mesh whose edges match."""
    problem = pin_in_bush(clearance, 2e-3)
    fine = am.mesh.graded(problem.domain, 0.01, ("pin.rim", "bush.hole"), 4)
    sides = [len(fine.boundary_nodes(name)) for name in ("pin.rim", "bush.hole")]
    assert abs(sides[0] - sides[1]) <= 2
    return on_mesh(problem, fine).contact.pressure.max()


@pytest.mark.slow
@pytest.mark.parametrize("engine", [am.Bisect(), am.Remesh()], ids=["bisected", "remeshed"])
@pytest.mark.parametrize("clearance", [1e-3, 0.0], ids=["clearance", "equal arcs"])
def test_adapted_meshes_have_the_peak_of_a_matching_mesh(engine, clearance):
    steps = list(am.adapt(pin_in_bush(clearance, 2e-3), 0.03, engine=engine, max_nodes=2500))
    peaks = [step.result.contact.pressure.max() for step in steps if step.result.mesh.n_nodes > 400]
    assert len(peaks) > 1
    assert peaks == pytest.approx([fine_peak(clearance)] * len(peaks), rel=0.02)


@pytest.mark.filterwarnings("error")
def test_chords_of_unknown_arcs_are_warned_of_and_exact_surfaces_are_not():
    problem = pin_in_bush(2e-4, 3e-4)
    mesh = am.mesh.graded(problem.domain, {"pin": 0.0098, "bush": 0.013})
    right = on_mesh(problem, mesh).contact.pressure.max()
    unknown = replace(problem, domain=None)
    with pytest.warns(UserWarning, match="chords that lie up to .* m behind.*at most") as caught:
        wrong = on_mesh(unknown, mesh).contact.pressure.max()
    assert len(caught) == 1 and wrong > 1.3 * right


def lame(r, inner, outer, interference, solid):
    """The pressure of a press fit of spheres (solid) or cylinders that are held at r = inner and at r
    = outer: u = A r + B / r^n, Lame."""
    young, poisson, n = 2e11, 0.3, 2 if solid else 1
    shear, bulk = young / (2 * (1 + poisson)), young / (3 * (1 - 2 * poisson))
    compliance = 0.0
    for held in (inner, outer):
        b = -(held ** (n + 1))
        u = r + b / r**n
        dilation = 3 * bulk if solid else 2 * (bulk + shear / 3)
        stress = dilation - 2 * n * shear * b / r ** (n + 1)
        compliance += abs(u / stress)
    return interference / compliance


@pytest.mark.parametrize("solid", [False, True], ids=["cylinders", "spheres, axisymmetric"])
@pytest.mark.parametrize("swapped", [False, True], ids=["inner slave", "outer slave"])
def test_press_fits_with_edges_that_do_not_match_have_lame_s_pressure(solid, swapped):
    r, interference = 0.1, 2e-5
    if solid:

        def shell(a, b, names):
            arcs = ((0, -b), (b, 0), (0, b), (0, a), (a, 0), (0, -a))
            return am.Outline(
                vertices=arcs,
                boundaries=(names[1], names[1], "axis", names[0], names[0], "axis"),
                arcs=dict.fromkeys((0, 1, 3, 4), (0, 0)),
            )
    else:
        shell = ring

    domain = am.Assembly(
        parts={
            "inner": shell(0.5 * r, r, ("core", "rim")),
            "outer": shell(r - interference, 2 * r, ("hole", "rest")),
        }
    )
    sides = ("inner.rim", "outer.hole")[:: -1 if swapped else 1]
    supports = (am.Support("inner.core", x=0, y=0), am.Support("outer.rest", x=0, y=0))
    problem = posed(
        domain,
        am.ContactPair(*sides, allow_interference=True),
        am.Axisymmetric if solid else None,
        supports=supports,
    )
    mesh = am.mesh.graded(domain, {"inner": 0.0098, "outer": 0.013})
    result = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), am.ActiveSet(rtol=1e-6))
    pressure, exact = result.contact.pressure, lame(r, 0.5 * r, 2 * r, interference, solid)
    assert np.median(pressure) == pytest.approx(exact, rel=0.02)
    # linear elements at the axis of symmetry take a tenth too little
    assert 0.88 * exact < pressure.min() and pressure.max() < 1.03 * exact
