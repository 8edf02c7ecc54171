"""Pictures of results, meshes and loops show the data of their arguments, body by body and pair by
pair."""

import dataclasses
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import FACTORS, MATERIALS, QUANTITIES, SOLIDS, steps_of, two_bodies
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from pictures import words
from refused import refused

import adaptmg as am
from adaptmg import plot
from adaptmg.plot.contact_surfaces import flattened, lines_of, polylines
from adaptmg.plot.style import STATE_COLORS, STATE_INKS
from adaptmg.plot.surfaces import ShadedSurface

BAR, PLANE, SOLID = result_on(square(16)), two_bodies(), two_bodies(3, 4, 3)


def two_pairs() -> am.Result:
    """The two blocks with the left half of the slave surface as one pair and the right half as
    another."""
    mesh, contact = PLANE.mesh, PLANE.contact
    labels = mesh.facet_labels.copy()
    slave, x = mesh.boundaries.index("upper.bottom"), mesh.points[mesh.facets].mean(axis=1)[:, 0]
    labels[(labels == slave) & (x > 0.02)] = len(mesh.boundaries)
    return dataclasses.replace(
        PLANE,
        mesh=dataclasses.replace(
            mesh, facet_labels=labels, boundaries=(*mesh.boundaries, "upper.right half")
        ),
        contact=dataclasses.replace(
            contact,
            names=("upper.bottom", "upper.right half"),
            masters=("lower.top", ""),
            boundary=(contact.x[:, 0] > 0.02).astype(int),
        ),
    )


def with_contact(result: am.Result, **changes) -> am.Result:
    return dataclasses.replace(result, contact=dataclasses.replace(result.contact, **changes))


def without_nodes(result: am.Result, nodes: list[int]) -> am.Result:
    c = result.contact
    return with_contact(
        result,
        **{
            name: np.delete(value, nodes, axis=0)
            for name, value in vars(c).items()
            if isinstance(value, np.ndarray) and len(value) == len(c)
        },
    )


# -- meshes and deformed bodies --------------------------------------------------------------------------------------


def test_meshes_and_the_levels_of_a_hierarchy_are_drawn():
    assert "81 nodes, 128 elements" in words(plot.mesh(square(8), contact=["bottom"]))
    figure = plot.mesh(cube(2), contact=["bottom"])
    assert "27 nodes" in words(figure) and figure.axes[0].elev < 0  # seen from below
    colors = plot.mesh(PLANE.mesh).axes[0].collections[0].get_facecolor()
    assert sorted(np.unique(colors, axis=0, return_counts=True)[1]) == sorted(
        np.bincount(PLANE.mesh.element_body)
    )
    figure = plot.grids(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    assert len(figure.axes) == 2 and "level 1: 25 nodes" in words(figure)
    assert len(figure.axes[1].collections[0].get_paths()) == 32
    # pyplot does not keep pictures, notebooks show them, and the settings of the user stay
    before = dict(plt.rcParams)
    assert not plt.get_fignums() and plot.mesh(square(2))._repr_png_().startswith(b"\x89PNG")
    assert dict(plt.rcParams) == before


def test_deformation_draws_each_body_in_a_color_and_names_it():
    (ax,) = plot.deformation(PLANE, amplify=20).axes
    moved = 1e3 * (PLANE.mesh.points + 20 * PLANE.displacement)
    (filled,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    legend = {
        text.get_text(): patch.get_facecolor()
        for text, patch in zip(
            ax.get_legend().get_texts(), ax.get_legend().legend_handles, strict=True
        )
        if isinstance(patch, Patch)
    }
    assert list(legend) == ["upper", "lower"] and len(set(legend.values())) == 2
    # the large body first, the small one over it
    mine = [
        np.flatnonzero(PLANE.mesh.element_body == PLANE.mesh.bodies.index(body))
        for body in ("lower", "upper")
    ]
    np.testing.assert_allclose(
        [path.vertices[:3] for path in filled.get_paths()],
        moved[PLANE.mesh.elements[np.concatenate(mine)]],
        rtol=1e-12,
    )
    np.testing.assert_array_equal(
        filled.get_facecolor(),
        np.repeat([legend["lower"], legend["upper"]], list(map(len, mine)), axis=0),
    )
    assert ax.get_title() == "two blocks: displacement drawn 20 times"
    assert ax.get_xlabel() == "x [mm]" and ax.get_aspect() == 1
    assert "drawn to scale" in words(plot.deformation(PLANE, 1))
    factor = float(words(plot.deformation(PLANE)).split("drawn ")[1].split(" times")[0])
    largest = np.linalg.norm(PLANE.displacement, axis=1).max()
    assert 0.03 < factor * largest / np.linalg.norm(np.ptp(PLANE.mesh.points, axis=0)) < 0.08
    # one body alone; large meshes without lines
    figure = plot.deformation(PLANE, bodies=["upper"])
    assert len(figure.axes[0].collections[0].get_paths()) == len(mine[1]) and "lower" not in words(
        figure
    )
    edges = np.isin(PLANE.mesh.facets, PLANE.mesh.elements[mine[1]]).all(axis=1).sum()
    assert [len(drawn.get_paths()) for drawn in figure.axes[0].collections[1:3]] == [edges, edges]
    for result, lines, lined in (
        (PLANE, None, True),
        (PLANE, False, False),
        (two_bodies(n=70, m=4), None, False),
    ):
        filled = plot.deformation(result, 0, lines=lines).axes[0].collections[0]
        assert (not np.array_equal(filled.get_edgecolor(), filled.get_facecolor())) is lined


def test_colors_of_the_displacement_are_its_length_at_the_nodes():
    values = 1e6 * np.linalg.norm(BAR.displacement, axis=1)
    ax, bar = plot.deformation(BAR, displacement=True).axes
    assert bar.get_ylim() == pytest.approx((0, values.max())) and "|u| [µm]" in words(ax.figure)
    (colored,) = [c for c in ax.collections if c.get_array() is not None]
    np.testing.assert_allclose(colored.get_array(), values)


def test_states_color_the_slave_surface():
    (ax,) = plot.deformation(PLANE, 10, states=True).axes
    inks, c = {to_rgba(STATE_INKS[s]): s for s in (am.OPEN, am.SLIP, am.STICK)}, PLANE.contact
    (drawn,) = [
        c for c in ax.collections if isinstance(c, LineCollection) and len(c.get_colors()) > 1
    ]
    moved = 1e3 * (PLANE.mesh.points + 10 * PLANE.displacement)[c.node]
    state_at = {tuple(np.round(p, 9)): s for p, s in zip(moved, c.state, strict=True)}
    for k, (segment, color) in enumerate(
        zip(drawn.get_segments(), drawn.get_colors(), strict=True)
    ):
        assert inks[tuple(color)] == state_at[tuple(np.round(segment[k % 2], 9))]
    assert len(drawn.get_segments()) == 2 * (len(c) - 1)
    assert {"open", "slip", "stick"} <= set(words(ax.figure).split("\n"))
    assert "stick" in words(plot.deformation(SOLID, states=True, bodies=["upper"]))


@pytest.mark.parametrize("result", [PLANE, SOLID], ids=["2D", "3D"])
def test_stress_is_that_of_each_body_in_megapascal(result):
    figure = plot.deformation(result, 0, stress=True)
    stress = am.discrete.von_mises(
        am.discrete.full_stress(
            result.mesh, MATERIALS if result.dim == 2 else SOLIDS, result.displacement
        )
    )
    label = f"von Mises stress [MPa], maximum {1e-6 * stress.max():.3g}"
    (bar,) = (ax for ax in figure.axes if ax.get_ylabel() == label)
    assert bar.get_ylim()[1] == pytest.approx(1e-6 * np.quantile(stress, 0.99))
    if result.dim == 2:
        # the larger body below, the second one, first
        order = np.argsort(1 - result.mesh.element_body, kind="stable")
        colors = plt.colormaps["viridis"](np.minimum(stress / np.quantile(stress, 0.99), 1.0))
        np.testing.assert_allclose(
            figure.axes[0].collections[0].get_facecolor(), colors[order], atol=0.01
        )
    else:
        # rubber low, steel high: each facet shows the element behind it
        (surface,) = figure.findobj(ShadedSurface)
        lower = surface.corners.mean(axis=1)[:, 2] < -1.0
        assert lower.any() and np.ptp(surface.colors[lower], axis=(0, 1)).max() < 0.05
        assert (
            np.abs(
                surface.colors[~lower].mean(axis=(0, 1)) - surface.colors[lower].mean(axis=(0, 1))
            ).max()
            > 0.3
        )


# -- contact ---------------------------------------------------------------------------------------------------------


def stated(ax) -> np.ndarray:
    """Points of the curve coloured by state."""
    return np.asarray(
        next(c for c in ax.collections if isinstance(c, PathCollection)).get_offsets()
    )


def test_contact_draws_pressure_friction_gap_and_slip():
    figure = plot.contact(PLANE)
    c, order = PLANE.contact, np.argsort(PLANE.contact.x[:, 0])
    for ax, values in zip(
        figure.axes, (1e-6 * c.pressure, 1e-6 * c.traction[:, 0], 1e6 * c.gap), strict=True
    ):
        np.testing.assert_allclose(
            stated(ax), np.column_stack([1e3 * c.x[order, 0], values[order]])
        )
        (curve,) = [c for c in ax.collections if isinstance(c, LineCollection)]
        np.testing.assert_array_equal(
            curve.get_colors(), [to_rgba(STATE_INKS[s]) for s in np.repeat(c.state[order], 2)[1:-1]]
        )
    (slip,) = [drawn for drawn in figure.axes[2].lines if drawn.get_label().startswith("slip")]
    np.testing.assert_allclose(slip.get_ydata(), 1e6 * c.slip[order, 0])
    (band,) = [b for b in figure.axes[1].collections if isinstance(b, PolyCollection)]
    assert band.get_paths()[0].get_extents().y0 == pytest.approx(
        -1e-6 * (c.limit / c.weights).max()
    )
    shown = words(figure)
    assert all(
        text in shown
        for text in ("'upper.bottom' on 'lower.top'", "pressure p\n[MPa]", "gap, slip\n[µm]")
    )
    assert "gap, slip\n[mm]" in words(plot.contact(with_contact(PLANE, gap=c.gap + 2e-3)))
    assert "frictionless" in words(
        plot.contact(with_contact(PLANE, limit=0 * c.limit, force_t=0 * c.force_t))
    )
    axes = Figure().subplots(3)
    assert plot.contact(BAR, axes) is axes[0].figure
    assert plot.contact(result_on(None)).axes[2].get_xlabel() == "contact node"


def test_contact_shades_the_zones_half_way_between_nodes():
    ax, x, state = plot.contact(BAR).axes[0], 1e3 * BAR.contact.x[:, 0], BAR.contact.state
    spans = {
        tuple(np.round(p.get_facecolor(), 6)): p.get_extents().transformed(ax.transData.inverted())
        for p in ax.patches
    }
    ends = 0.5 * (np.r_[x[0], x] + np.r_[x, x[-1]])
    for code in (am.OPEN, am.SLIP, am.STICK):
        span, inside = (
            spans[tuple(np.round(to_rgba(STATE_COLORS[code]), 6))],
            np.flatnonzero(state == code),
        )
        assert (span.x0, span.x1) == pytest.approx(
            (ends[inside[0]], ends[inside[-1] + 1]), abs=1e-9
        )


def test_contact_draws_each_pair_or_one():
    assert len(plot.contact(two_pairs()).axes) == 6
    shown = words(plot.contact(two_pairs(), boundary="upper.right half"))
    assert "'upper.right half'" in shown and "lower.top" not in shown
    assert "lower.top" in words(
        plot.contact(two_pairs(), boundary=am.ContactPair("upper.bottom", "lower.top"))
    )


def test_polylines_use_every_edge_once_and_close_rings():
    ring, other, line = [[1, 2], [0, 1], [2, 0]], [[4, 5], [5, 4]], [[6, 9], [7, 6]]
    assert [one.tolist() for one in polylines(np.array([*ring, *line, *other]))] == [
        [7, 6, 9],
        [0, 1, 2, 0],
        [4, 5, 4],
    ]


def test_a_curved_contact_line_is_drawn_against_its_arc_length():
    angle = np.linspace(0, np.pi / 2, 9)
    inner, outer = (radius * np.stack([np.cos(angle), np.sin(angle)], 1) for radius in (1, 2))
    k = np.arange(8)
    elements = np.vstack([np.stack([k, 9 + k, 10 + k], 1), np.stack([k, 10 + k, 1 + k], 1)])
    facets = np.vstack(
        [np.stack([9 + k, 10 + k], 1), np.stack([1 + k, k], 1)[::-1], [[0, 9], [17, 8]]]
    )
    mesh = am.MeshArrays(
        np.vstack([inner, outer]), elements, facets, [0] * 8 + [1] * 10, ("bottom", "rest")
    )
    result, h = result_on(mesh), np.linalg.norm(outer[1] - outer[0])
    (only,) = lines_of(result, "bottom")
    assert only.label == "arc length from (2, 0) [m]"
    np.testing.assert_allclose(only.position, h * np.arange(9))
    (rest,) = lines_of(without_nodes(result, [np.argmax(result.contact.x[:, 0])]), "bottom")
    assert rest.label == "arc length from ({:.4g}, {:.4g}) [m]".format(*outer[1])
    np.testing.assert_allclose(rest.position, h * np.arange(8), atol=1e-15)


def test_a_small_patch_of_contact_fills_the_picture():
    corners = ((0, 0.05), (0, 0), (0.05, 0.05))
    roller = am.ContactProblem(
        domain=am.Outline(vertices=corners, boundaries=("axis", "arc", "cut"), arcs={1: (0, 0.05)}),
        material=am.PlaneStrain(young=2.1e11, poisson=0.3),
        contact=am.Contact("arc", am.Plane((0, 0), (0, 1))),
        law=am.Frictionless(),
        loads=am.Pressure("cut", 1e6),
        supports=am.Support("axis", normal=0),
    )
    result = am.solve(am.Hierarchy.graded(roller))
    half_width = np.ptp(result.contact.x[result.contact.closed], axis=0).max()
    axes = am.plot.contact(result).axes
    left, right = np.diff([ax.get_xlim() for ax in axes]).ravel()[[0, -1]]
    # mm; the arc is 78 mm long
    assert left == right == pytest.approx(2.5 * 1e3 * half_width, rel=0.1)
    assert axes[0].get_ylim()[1] > 1e-6 * result.max_pressure
    # the gap is that of the surroundings, not of the whole arc
    assert axes[2].get_ylim()[1] < 50


def test_parts_without_contact_nodes_interrupt_the_line():
    result = without_nodes(two_bodies(n=10), [4])
    first, second = lines_of(result, "upper.bottom")
    np.testing.assert_allclose(first.position, 4.0 * np.arange(4), atol=1e-9)
    np.testing.assert_allclose(second.position, 4.0 * np.arange(5, 11))
    # of the ten edges those that touch the node have no state
    figure = plot.deformation(result, states=True)
    (marks,) = [c for c in figure.axes[0].collections if c.get_linewidth()[0] == 2.8]
    assert len(marks.get_segments()) == 16


def test_surfaces_are_drawn_flat_and_a_hole_is_unrolled():
    # on the wall of a hole about the line x = 0.1, y = 0.2 along z
    angle, z = (
        part.ravel() for part in np.meshgrid(np.arange(-170, 180, 20.0), np.linspace(0.0, 0.03, 5))
    )
    normal = -np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0 * angle], 1)
    n, zero, flat = len(z), np.zeros((len(z), 2)), 0 * z
    contact = dataclasses.replace(
        SOLID.contact,
        node=np.arange(n),
        x=[0.1, 0.2, 0.0] - 0.015 * normal + np.stack([flat, flat, z], 1),
        frames=np.stack(
            [normal, np.cross([0, 0, 1.0], normal), np.tile([0, 0, 1.0], (n, 1))], axis=1
        ),
        u_t=zero,
        slip=zero,
        force_t=zero,
        gap=flat,
        u_n=flat,
        force_n=1e3 * z,
        weights=np.full(n, 1e-6),
        limit=flat,
        state=np.full(n, 1),
        boundary=np.zeros(n, int),
    )
    result = dataclasses.replace(SOLID, contact=contact, mesh=None)
    flat = flattened(result, "upper.bottom")
    np.testing.assert_allclose(
        flat.points, np.column_stack([(angle + 360) % 360 - 180, 1e3 * z]), atol=1e-9
    )
    assert flat.labels == ("angle of the normal around z [°]", "z [mm]") and not flat.equal
    # closed everywhere: no scale from 0 to 1
    shown = words(plot.contact(result))
    assert "gap = 0" in shown and "gap [µm]" not in shown
    shown = words(plot.contact(SOLID))
    assert all(
        text in shown
        for text in ("'upper.bottom' on 'lower.rest'", "contact pressure p [MPa]", "gap [µm]")
    )


# -- histories -------------------------------------------------------------------------------------------------------


def test_history_draws_what_was_recorded():
    ax = plot.history(BAR).axes[0]
    drawn = {line.get_label(): line for line in ax.lines}
    residual, estimate = (
        drawn["natural residual"],
        drawn["estimated error"],
    )
    np.testing.assert_array_equal(
        residual.get_xydata().T, [BAR.history["work_units"], BAR.history["residual"]]
    )
    np.testing.assert_array_equal(estimate.get_ydata(), BAR.history["error_estimate"][1:])
    assert ax.get_yscale() == "log" and ax.get_xlabel() == "work units"
    # several results by what all recorded
    ax = plot.history({"a": BAR, "b": BAR}, against="cycle").axes[0]
    assert ax.get_ylabel().startswith("natural residual") and {x.get_label() for x in ax.lines} >= {
        "a",
        "b",
    }
    short = dataclasses.replace(
        BAR, history={k: v for k, v in BAR.history.items() if k != "residual"}
    )
    assert plot.history({"a": BAR, "b": short}).axes[0].get_ylabel().startswith("estimated error")
    # a solve that ends by its change, with a reference, records all five quantities
    five = am.solve(
        am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)),
        am.Multigrid(correction=am.Monotone(), stop="change"),
        reference=np.ones((25, 2)),
    )
    assert len(plot.history(five).axes[0].get_legend().get_texts()) == 5


def test_the_cycle_diagram_climbs_from_level_to_level():
    ax = plot.path(BAR, steps=11).axes[0]
    assert [tuple(line.get_ydata()) for line in ax.lines] == [
        (0, 1),
        (1, 0),
        (0, 1),
        (1, 2),
        (2, 1),
        (1, 0),
    ]
    shown = words(ax.figure)
    assert "first 11 of" in shown and "level 2\n289 nodes" in shown and "restrict residual" in shown


def test_adaptation_draws_meshes_states_indicator_and_errors():
    steps = list(am.adapt(am.cases.dovetail(), 10e-3, engine=am.Bisect(), max_nodes=300))
    figure = plot.adaptation(steps)
    for name, x in (
        ("nodes", [s.nodes for s in steps]),
        ("time", [s.total_seconds for s in steps]),
    ):
        ax = next(ax for ax in figure.axes if ax.get_xlabel().startswith(name))
        np.testing.assert_allclose(
            ax.lines[0].get_xydata().T, [x, [s.estimate.relative for s in steps]]
        )
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert [ax.get_ylabel().partition(" / ")[0] for ax in figure.axes[-2:]] == ["estimate", ""]
    titles = [ax.get_title() for ax in figure.axes]
    assert (
        f"step 0: {steps[0].nodes} nodes" in titles
        and f"step {len(steps) - 1}: {steps[-1].nodes} nodes" in titles
    )
    assert {text.get_text() for text in figure.legends[0].get_texts()} <= {"open", "slip", "stick"}
    assert len(figure.axes[0].collections[0].get_paths()) == len(steps[0].result.mesh.elements)
    (bar,) = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    low, high = bar.get_ylim()
    assert (
        high == pytest.approx(np.sqrt(steps[-1].estimate.squares).max())
        and low >= 1e-4 * high * 0.99
    )
    # the rate of smooth solutions, of a goal twice that of the energy norm
    goal = am.adapt(
        am.cases.greco_bar(), 20e-3, indicator=am.Goal(am.ContactForce("bottom", "x")), max_nodes=60
    )
    for each, power in ((steps, "-1/2"), (list(goal), "-1")):
        assert f"nodes$^{{{power}}}$" in words(plot.adaptation(each))


def test_load_history_draws_quantities_and_pressures():
    steps = steps_of(PLANE)
    figure = plot.load_history(steps, FACTORS, QUANTITIES)
    for ax, (label, function) in zip(figure.axes[:2], QUANTITIES.items(), strict=True):
        assert ax.get_ylabel() == label and ax.get_xlabel() == "load factor"
        np.testing.assert_allclose(
            ax.lines[0].get_xydata().T, [FACTORS, [function(step) for step in steps]]
        )
    order = np.argsort(PLANE.contact.x[:, 0])
    for ax, step, factor in zip(figure.axes[2:], steps, FACTORS, strict=True):
        np.testing.assert_allclose(stated(ax)[:, 1], 1e-6 * step.contact.pressure[order])
        assert ax.get_title() == f"load factor {factor:g}"
    # as many steps as requested, the first, the last and those of the largest factor or pressure
    # among them
    figure = plot.load_history(steps, FACTORS, {}, steps=2)
    assert [ax.get_title() for ax in figure.axes] == ["load factor 0.25", "load factor 0.5"]
    assert "2 of 4 steps" in words(figure)
    for factors, title in ((range(4), "load factor 1"), ((0, 4, 2, 3), "load factor 4")):
        assert title in words(plot.load_history(steps[::-1], factors, {}, steps=3)).split("\n")
    assert len(plot.load_history(steps, FACTORS, QUANTITIES, steps=0).axes) == 2
    # peaks next to each other do not take each other's place; of three steps that of the factor is drawn
    rising = [
        dataclasses.replace(
            PLANE, contact=dataclasses.replace(PLANE.contact, force_n=k * PLANE.contact.force_n)
        )
        for k in (1, 2, 3, 9, 4, 3, 2, 1, 1, 1)
    ]
    factors = (0, 1, 2, 3, 6, 5, 4, 3, 2, 1)
    for most, numbers in ((4, (0, 3, 4, 9)), (3, (0, 4, 9)), (2, (0, 9)), (1, (0,))):
        figure = plot.load_history(rising, factors, {}, steps=most)
        assert [ax.get_title() for ax in figure.axes] == [
            f"load factor {factors[k]}" for k in numbers
        ]
    assert "contact pressure [MPa]" in words(
        plot.load_history(steps_of(SOLID), FACTORS, QUANTITIES, against="step")
    )
    assert len(plot.load_history(steps_of(two_pairs()), FACTORS, {}, steps=3).axes) == 6


EMPTY = dataclasses.replace(BAR, history={"cycle": [1], "work_units": [1.0]})
test_refused = refused(
    (lambda: plot.mesh("bar.msh"), TypeError, "MeshArrays"),
    (lambda: plot.grids([square(2)]), TypeError, "Hierarchy"),
    (
        lambda: plot.grids(
            am.Hierarchy.single(am.Hierarchy.uniform(am.cases.greco_bar(), 2).finest.discrete)
        ),
        "no mesh",
    ),
    *(
        (lambda result=result, options=options: plot.deformation(result, **options), message)
        for result, options, message in (
            (result_on(None), {}, "no mesh"),
            (PLANE, {"amplify": float("nan")}, "amplify"),
            (PLANE, {"bodies": ["middle"]}, "must be one of 'upper', 'lower'"),
            (dataclasses.replace(PLANE, stress_data=None), {"stress": True}, "no materials"),
            (SOLID, {"stress": True, "displacement": True}, "two pictures"),
            (SOLID, {"ax": Figure().subplots()}, "three-dimensional"),
        )
    ),
    (lambda: plot.contact(BAR, boundary="top"), "boundary must be one of 'bottom'"),
    (lambda: plot.contact(BAR, Figure().subplots()), "3 matplotlib axes"),
    (lambda: plot.history({"a": BAR, "b": EMPTY}), "in common"),
    (lambda: plot.history(BAR, "time"), "against"),
    (lambda: plot.history({"a": 1}), TypeError, "Result"),
    (lambda: plot.path(dataclasses.replace(BAR, path=[])), "no cycles"),
    (lambda: plot.adaptation([]), "steps"),
    (lambda: plot.adaptation([1]), TypeError, "steps"),
    (
        lambda: plot.load_history(steps_of(PLANE), FACTORS, {"force": lambda r: np.nan}),
        "'force'.*step 0 must be",
    ),
    *(
        (
            lambda other=other: plot.load_history([PLANE, other], FACTORS[:2], QUANTITIES),
            "same mesh",
        )
        for other in (SOLID, two_bodies(size=0.03))
    ),
    (lambda: plot.load_history(steps_of(PLANE), FACTORS, {}, steps=0), "nothing to draw"),
)


def test_a_contact_patch_is_centred_and_does_not_fold():
    """Of a cylinder on a rigid plane that moves into it, turned; the problem has no name."""
    normal = np.array([0.28, -0.96])
    along = np.array([0.96, 0.28])
    corners = [10e-3 * side * along for side in (-1, 0, 1)]
    corners[1] = 10e-3 * normal
    plane = am.Moving(am.Plane(corners[1], -normal), displacement=-2e-6 * normal)
    problem = am.ContactProblem(
        domain=am.Outline(
            vertices=corners, boundaries=("low", "low", "top"), arcs={0: (0, 0), 1: (0, 0)}
        ),
        material=am.PlaneStrain(young=2.1e11, poisson=0.3),
        law=am.Frictionless(),
        contact=am.Contact("low", plane),
        supports=am.Support("top", x=0, y=0),
    )
    sizes = am.SizeNear([corners[1]], size=2e-5)
    grids = am.Hierarchy.from_meshes(problem, [am.mesh.sized(problem.domain, sizes, 2e-3)])
    result = am.solve(grids)
    axes = plot.contact(result).axes
    assert axes[-1].get_xlabel() == "x [mm]" and axes[0].get_title() == "'low'"
    assert "problem" not in f"{grids}{result}"
    assert np.mean(axes[-1].get_xlim()) == pytest.approx(1e3 * corners[1][0], abs=0.05)
    drawn = plot.deformation(result, stress=True)
    factor = float(re.fullmatch(r"displacement drawn (\d+) times", drawn.axes[0].get_title())[1])
    closed = result.contact.node[result.contact.closed]
    lift = result.displacement[closed] @ normal
    assert 0 < factor * np.ptp(lift) < 0.3 * result.contact_area


def test_friction_bounds_that_are_errors_of_the_solve_look_like_zero():
    result = am.solve(am.Hierarchy.graded(am.cases.dovetail(), (10e-3, 5e-3)))
    contact = result.contact
    on_floor = contact.boundary == contact.names.index("tongue.bottom")
    assert not contact.closed[on_floor].any()
    error = 1e-8 * contact.pressure.max()  # about rtol
    limit = np.where(on_floor, error * contact.weights, contact.limit)
    noisy = dataclasses.replace(result, contact=dataclasses.replace(contact, limit=limit))
    _, friction, _ = plot.contact(noisy, boundary="tongue.bottom").axes
    assert friction.get_ylim()[1] > 1e3 * 1e-6 * error  # MPa


def test_the_label_of_stresses_fits_the_scale_of_a_flat_body():
    flat = dataclasses.replace(PLANE.mesh, points=PLANE.mesh.points * [1.0, 0.35])
    scale = plot.deformation(dataclasses.replace(PLANE, mesh=flat), stress=True).axes[1]
    assert scale.yaxis.label.get_window_extent().height <= scale.get_window_extent().height


def test_amplified_bodies_hardly_overlap_where_a_gap_has_closed():
    problem = am.cases.hertz_cylinder()
    result = am.solve(am.Hierarchy.graded(problem, sizes=(8e-3, 4e-3), contact_ratio=32))
    title = am.plot.deformation(result).axes[0].get_title()
    factor = float(re.search(r"drawn (\d+) times", title)[1])
    mesh, size = result.mesh, np.linalg.norm(np.ptp(result.mesh.points, axis=0))
    moved = mesh.points + factor * result.displacement
    block = moved[mesh.boundary_nodes("lower.contact")]
    block = block[np.argsort(block[:, 0])]
    x, y = moved[mesh.boundary_nodes("upper.contact")].T
    inside = np.interp(x, *block.T) - y
    assert 0 < inside.max() < 0.006 * size and factor >= 5
