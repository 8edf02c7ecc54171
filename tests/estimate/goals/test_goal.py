"""Goals: signed estimates against true errors, what quantities are, what marks bring, and what is
refused."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import rotation

import adaptmg as am
from adaptmg.estimate.quantities import Functional

REFERENCE = am.cases.greco_bar().reference
POINTS = np.array(list(REFERENCE["points"].values()))
CONVERGED = np.array(list(REFERENCE["values"]["converged"].values()))
LINE = am.Displacement(POINTS, "x")


def solved(problem, **made):
    hierarchy = (
        am.Hierarchy.graded(problem, **made)
        if "sizes" in made
        else am.Hierarchy.uniform(problem, **made)
    )
    return hierarchy, am.solve(
        hierarchy, am.FullMultigrid(rtol=1e-8) if len(hierarchy) > 1 else am.ActiveSet()
    )


@cache
def bar(divisions):
    return solved(am.cases.greco_bar(), divisions=(divisions,))


def test_points_of_the_bar_have_their_converged_values():
    estimate = am.Goal(LINE).indicate(*bar(16))
    errors = CONVERGED - estimate.values
    effectivity = estimate.errors / errors
    assert effectivity.min() > 0.8 and effectivity.max() < 1.25  # measured 1.14 to 1.23
    assert np.abs(CONVERGED - estimate.corrected).max() < 0.25 * np.abs(errors).max()
    assert estimate.signed == pytest.approx(
        (estimate.errors / estimate.values)[np.argmax(np.abs(estimate.errors / estimate.values))]
    )
    assert estimate.relative == abs(estimate.signed)


def test_the_axisymmetric_and_the_energy_estimate():
    hierarchy, result = solved(am.cases.bolted_junction(), sizes=(8e-3,))
    name = hierarchy.problem.contact_boundaries[0]
    estimate = am.Goal([am.ContactForce(), am.Opening(), am.MeanDisplacement(name, "y")]).indicate(
        hierarchy, result
    )
    assert np.isfinite(estimate.errors).all() and estimate.errors[0] < 0 < estimate.errors[1]
    assert estimate.values[2] == pytest.approx(
        mean_by_simpson(result.mesh, name, result.displacement[:, 1])
    )
    other = am.Recovery().indicate(hierarchy, result).relative
    assert 0.4 < estimate.discretisation / other < 2.0


def test_quantities_are_those_of_the_result():
    hierarchy, result = solved(am.cases.dovetail(), sizes=(6e-3,))
    slave, master = result.contact.names[0], result.contact.masters[0]
    mine = result.contact.boundary == 0
    fourth = np.flatnonzero(mine)[3]
    weights = result.contact.weights[mine]
    for quantity, wanted in (
        (am.Displacement((20e-3, -30e-3), "x"), result.probe([(20e-3, -30e-3)])[0, 0]),
        (am.ContactForce(slave), result.contact.force_n[mine].sum()),
        (am.ContactForce(slave, "tangential"), result.contact.force_t[mine].sum()),
        (am.ContactForce(f"{slave} on {master}", "y"), result.resultant(slave).force[1]),
        (am.ContactForce(master, "y"), result.resultant(master).force[1]),
        (am.Opening(slave, result.contact.x[fourth]), result.contact.gap[fourth]),
        (am.Opening(slave), weights @ result.contact.gap[mine] / weights.sum()),
    ):
        assert am.Goal(quantity).indicate(hierarchy, result).value == pytest.approx(
            wanted, rel=1e-6, abs=1e-15
        )
    # of the bar, at whose corner a support holds a node that sticks
    tangential = am.Goal(am.ContactForce("bottom", "tangential")).indicate(*bar(16)).value
    assert tangential == pytest.approx(bar(16)[1].contact.force_t.sum(), rel=1e-9)


def mean_by_simpson(mesh, name, u):
    """The mean of u over a boundary with the weight r; Simpson's rule is exact for products of
    linear functions."""
    a, b = (mesh.boundary_facets(name)[:, k] for k in (0, 1))
    length, r = np.linalg.norm(mesh.points[a] - mesh.points[b], axis=1), mesh.points[:, 0]
    total = length / 6 * (r[a] * u[a] + (r[a] + r[b]) * (u[a] + u[b]) + r[b] * u[b])
    return total.sum() / (length * (r[a] + r[b]) / 2).sum()


def test_terms_add_up_and_quantities_count_relatively():
    def lever(view):
        nodal = np.zeros(view.mesh.points.shape)
        nodal[0, 0] = 2.0
        return [Functional("lever", 2 * view.displacement[0, 0], "m", view.load_of(nodal))]

    estimate = am.Goal(
        [am.Displacement(POINTS[:1], 0), am.ContactForce(direction="tangential")]
    ).indicate(*bar(16))
    assert sum(estimate.terms.values()) == pytest.approx(estimate.squares.sum())
    assert list(estimate.terms) == list(estimate.names)
    alone = am.Goal(am.Displacement(POINTS[0], "x")).indicate(*bar(16))
    assert estimate.terms[estimate.names[0]] == pytest.approx(
        alone.squares.sum() / abs(alone.value)
    )
    assert estimate.errors[0] == pytest.approx(alone.signed) and estimate.value == 1.0
    assert "estimated error" in repr(estimate) and estimate.names[1] in repr(estimate)
    corner = am.Goal(am.Displacement(bar(16)[1].mesh.points[0], 0)).indicate(*bar(16))
    own = am.Goal(SimpleNamespace(functionals=lever)).indicate(*bar(16))
    assert own.signed == pytest.approx(2 * corner.signed)
    # what equilibrium or a support gives has no error
    estimate = am.Goal(am.ContactForce()).indicate(*bar(16))
    assert (
        estimate.value == pytest.approx(2e6)
        and abs(estimate.signed) < 1e-3
        and estimate.squares.max() < 1e-3
    )
    estimate = am.Goal(am.MeanDisplacement("right", "x")).indicate(*bar(4))
    assert estimate.value == 0 and not estimate.squares.any() and estimate.relative == 0


def test_what_a_support_prescribes_of_a_mean_has_no_error_at_any_angle():
    """The errors of the components turn with the body."""
    errors = []
    for turn in (rotation(0.0), rotation(0.4)):
        mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e7, poisson=0.3),
            law=am.Coulomb(0.3),
            contact=am.Contact("bottom", am.Plane((0, 0), turn[:, 1])),
            loads=[am.Traction("right", turn @ [1e3, -2e3])],
            supports=[am.Support("left", normal=-1e-4)],
        )
        meshes = [dataclasses.replace(mesh, points=mesh.points @ turn.T)]
        grids = am.Hierarchy.from_meshes(problem, meshes)
        goal = am.Goal([am.MeanDisplacement("left", axis) for axis in "xy"])
        errors.append(goal.indicate(grids, am.solve(grids, am.ActiveSet())).errors @ turn)
    size = np.abs(errors[0][1])
    assert errors[0][0] == 0 and size > 1e-7
    np.testing.assert_allclose(errors[1], errors[0], atol=1e-6 * size)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_goal_sees_what_an_interpolated_normal_displacement_misses(turn):
    """A block that a parabola pushes from the left moves by its mean, h^2 / 6 less than the mean of its
    interpolant."""
    turn = rotation(turn)
    mesh = am.mesh.structured(am.Rectangle(width=1, height=0.5), (8, 4))
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0, 0), turn[:, 1])),
        supports=[
            am.Support("left", normal=lambda x: -1e-3 * (x @ turn[:, 1]) ** 2),
            am.Support("top", normal=-2e-3),
        ],
    )
    turned = dataclasses.replace(mesh, points=mesh.points @ turn.T)
    grids = am.Hierarchy.from_meshes(problem, [turned])
    goal = am.Goal([am.MeanDisplacement("right", axis) for axis in "xy"])
    estimate = goal.indicate(grids, am.solve(grids, am.ActiveSet()))
    assert estimate.errors @ turn[:, 0] == pytest.approx(-1e-3 * 0.125**2 / 6, rel=0.01)


@pytest.mark.parametrize(("turn", "size"), [(0.0, 1.0), (0.7, 1e-3)])
def test_a_goal_sees_what_interpolated_supports_miss(turn, size):
    """A field of third order on a floor, held at the top by a function."""
    turn, shift, young, poisson, pressure = rotation(turn), np.array([0.3, -2.0]), 1e9, 0.3, 1e5
    a = pressure / 20  # of the Airy function a (6 x^2 y^2 - x^4 - y^4) - pressure x^2 / 2
    c = 12 * a * (1 + poisson) / young

    def local(points):
        return (points @ turn / size - shift).T

    def top(points):
        x, y = local(points)
        u = np.column_stack([c * (x * y**2 - x**3 / 3), c * (x**2 * y - y**3 / 3)])
        return size * (u + pressure / young * np.column_stack([poisson * x, -y])) @ turn.T

    def sides(normal, points):
        x, y = local(points)
        return normal * np.column_stack([-12 * a * (x**2 - y**2), 24 * a * x * y]) @ turn.T

    mesh = am.mesh.structured(am.Rectangle(width=2, height=0.5, origin=(-1, 0)), (16, 4))
    mesh = dataclasses.replace(mesh, points=size * (mesh.points + shift) @ turn.T)
    problem = am.ContactProblem(
        material=am.PlaneStress(young=young, poisson=poisson),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane(size * turn @ shift, turn[:, 1])),
        loads=[
            am.Traction(side, tuple(lambda x, n=n, k=k: sides(n, x)[:, k] for k in (0, 1)))
            for side, n in (("left", -1), ("right", 1))
        ],
        supports=[am.Support("top", **{"xy"[k]: lambda x, k=k: top(x)[:, k] for k in (0, 1)})],
    )
    grids = am.Hierarchy.from_meshes(problem, [mesh])
    estimate = am.Goal(am.ContactForce("bottom", "normal")).indicate(grids, am.solve(grids))
    true = size * (2 * pressure - 8 * a) - estimate.value
    assert estimate.signed == pytest.approx(true, rel=0.2)
    assert abs(true) > 1e-4 * estimate.value


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_goal_sees_what_interpolated_gaps_miss(size):
    """Bending of a block pressed on a floor of the form to which it bends."""
    young, poisson, pressure, curvature, height = 1e9, 0.3, 1e5, 1e-3, 0.5
    bent = curvature / size  # v = -(k (x^2 + nu y^2) / 2 + pressure y / E)
    domain = am.Rectangle(width=2 * size, height=height * size, origin=(-size, 3 * size))
    problem = am.ContactProblem(
        domain=domain,
        material=am.PlaneStress(young=young, poisson=poisson),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.GapFunction(lambda x: 0.5 * bent * x[:, 0] ** 2)),
        loads=[
            am.Pressure("top", pressure),
            *(
                am.Traction(side, (lambda x, n=n: n * young * bent * (x[:, 1] - 3 * size), 0.0))
                for side, n in (("left", -1), ("right", 1))
            ),
        ],
        supports=[am.PointSupport((0, (3 + height) * size), x=0.0)],
    )
    grids = am.Hierarchy.uniform(problem, divisions=((16, 4),))
    estimate = am.Goal(am.MeanDisplacement("top", "y")).indicate(grids, am.solve(grids))
    exact = -size * (curvature * (1 / 3 + poisson * height**2) / 2 + pressure * height / young)
    assert estimate.signed == pytest.approx(exact - estimate.value, rel=0.2)
    assert abs(estimate.signed) > 1e-4 * abs(exact)


def test_what_has_no_meaning_is_refused():
    zero = am.Opening("bottom", (20e-3, 0.0))
    for quantity, on, words in (
        ([zero, am.ContactForce()], bar(16), "is zero"),
        ([am.ContactForce(), am.ContactForce()], bar(16), "given twice"),
        (
            am.ContactForce(direction="tangential"),
            solved(am.cases.greco_block(), divisions=(2,)),
            "in 3D",
        ),
    ):
        with pytest.raises(ValueError, match=words):
            am.Goal(quantity).indicate(*on)


def dovetail_of_tresca():
    """Open nodes, which have friction too, slip."""
    return dataclasses.replace(am.cases.dovetail(), law=am.Tresca(1e5))


@pytest.mark.parametrize(
    "make", [am.cases.greco_bar, am.cases.greco_block, am.cases.dovetail, dovetail_of_tresca]
)
@pytest.mark.filterwarnings("ignore:.*open nodes carry:UserWarning")
def test_what_the_solver_leaves_counts(make):
    problem = make()
    hierarchy = am.Hierarchy.graded(problem, (8e-3, 4e-3) if problem.dim == 2 else (15e-3,))
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    # any admissible change of the displacement that leaves the states alone is an algebraic error
    discrete, contact = hierarchy.finest.discrete, exact.contact
    change = np.random.default_rng(0).standard_normal(exact.displacement.shape)
    change[discrete.contact.nodes] = 0.0
    change[discrete.fixed.reshape(change.shape)] = 0.0
    far = discrete.relative(exact.displacement) + 1e-4 * np.abs(exact.displacement).max() * change
    left = discrete.matrix @ far.reshape(-1) - discrete.load
    left = left if discrete.coupling is None else discrete.coupling.physical_forces(left)
    loose = dataclasses.replace(
        exact, displacement=discrete.physical(far), reaction=left.reshape(far.shape)
    )
    moved = exact.mesh.points[np.argmax(np.abs(exact.displacement[:, 0]))]
    for item in (am.Displacement(moved, 0), am.MeanDisplacement(contact.names[0], 0)):
        true, found = (am.Goal(item).indicate(hierarchy, result) for result in (exact, loose))
        assert abs(true.algebraic[0]) < 1e-9 * abs(true.value)
        assert found.algebraic[0] == pytest.approx(
            true.value - found.value, rel=2e-2, abs=1e-7 * abs(true.value)
        )


def test_an_opening_that_all_nodes_hold_closed_marks_elements():
    hierarchy, result = bar(2)
    assert (result.contact.state != am.OPEN).all()
    estimate = am.Goal(am.Opening("bottom")).indicate(hierarchy, result)
    energy = am.Recovery().indicate(hierarchy, result).relative
    # marks are those of the energy, not of the closed gap alone
    assert (
        estimate.value == 0
        and 0.5 < estimate.discretisation / energy < 2
        and estimate.relative == np.inf
    )
    assert estimate.squares.min() > 1e-4 * estimate.squares.max()
    steps = list(
        am.adapt(
            am.cases.greco_bar(),
            20e-3,
            am.Goal(am.Opening("bottom")),
            engine=am.Bisect(),
            max_nodes=150,
        )
    )
    assert (
        steps[0].estimate.value == 0
        and steps[-1].estimate.value > 2e-8
        and "max_nodes" in steps[-1].outcome
    )


def disc(kind):
    shape = am.Outline(
        vertices=((0, 0), (0.04, 0.02), (0.04, 0.05), (0, 0.05)),
        boundaries=("round", "side", "top", "axis"),
        arcs={0: (0.0, 0.05)},
    )
    return am.ContactProblem(
        domain=shape,
        material=kind(young=2e11, poisson=0.3),
        law=am.Frictionless(),
        contact=am.Contact("round", am.Plane((0, 0), (0, 1))),
        supports=(am.Support("axis", x=0.0), am.Support("top", y=-5e-5)),
    )


def valley():
    problem = am.cases.greco_bar()
    front = am.GapFunction(lambda x: 5 * x[:, 0] ** 2)
    return dataclasses.replace(problem, law=am.Frictionless(), contact=am.Contact("bottom", front))


@pytest.mark.parametrize(
    ("problem", "point", "sizes", "share"),
    [
        (disc(am.PlaneStrain), None, (8e-3, 1e-3), 0.1),
        (disc(am.Axisymmetric), None, (8e-3, 1e-3), 0.1),
        # in the middle of an edge the factor 4/3 is too much
        (valley(), (0.037, 0.0), (2e-3, 8e-4), 0.34),
    ],
    ids=["plane", "axisymmetric", "point before a gap function"],
)
def test_openings_of_curves_contain_what_chords_change(problem, point, sizes, share):
    goal = am.Goal(am.Opening(problem.contact[0].boundary, point=point))
    coarse, fine = (am.Hierarchy.graded(problem, (size,)) for size in sizes)
    estimate, right = (goal.indicate(one, am.solve(one, am.ActiveSet())) for one in (coarse, fine))
    assert estimate.signed == pytest.approx(right.value + right.signed - estimate.value, rel=share)
    # marked where they lie, all along the boundary
    assert (estimate.squares > 0).sum() > 5 and sum(estimate.terms.values()) == pytest.approx(
        estimate.squares.sum()
    )
