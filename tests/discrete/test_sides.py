"""Which side of a pair is the slave."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import slabs, turned

import adaptmg as am
from adaptmg.discrete.sides import with_sides


def pair(contrast, slave="upper.bottom", master="lower.top", finer="lower", sides="auto", **others):
    """A block pressed on a wider one of the same modulus over ``contrast``, meshed finely where
    ``finer`` says."""
    problem = am.ContactProblem(
        domain=am.Assembly(
            parts={
                "upper": am.Rectangle(width=30e-3, height=20e-3, origin=(15e-3, 0.0)),
                "lower": am.Rectangle(width=60e-3, height=30e-3, origin=(0.0, -30e-3)),
            }
        ),
        material={
            "upper": am.PlaneStrain(young=2e11, poisson=0.3),
            "lower": am.PlaneStrain(young=2e11 / contrast, poisson=0.3),
        },
        contact=am.ContactPair(slave, master, sides=sides),
        law=am.Coulomb(0.3),
        loads=(am.Pressure("upper.top", 1e4),),
        supports=(am.Support("lower.bottom", x=0.0, y=0.0),),
        **others,
    )
    return problem, [{"upper": size, "lower": size} | {finer: size / 1.5} for size in (8e-3, 4e-3)]


@pytest.mark.parametrize(
    ("contrast", "finer", "slave"),
    [
        (1e3, "upper", "lower.top"),
        (1e-3, "lower", "upper.bottom"),
        (1.5, "upper", "upper.bottom"),
        (0.7, "lower", "lower.top"),
    ],
)
def test_auto_takes_the_softer_then_the_finer_side_either_way_written(contrast, finer, slave):
    made = [
        am.Hierarchy.graded(*pair(contrast, *names, finer))
        for names in (("upper.bottom", "lower.top"), ("lower.top", "upper.bottom"))
    ]
    results = [am.solve(grids) for grids in made]
    for grids, result in zip(made, results, strict=True):
        assert (
            result.contact.names == grids.problem.contact_boundaries == (slave,)
            and result.cycles <= 15
        )
        up, down = (result.resultant(name).force for name in ("upper.bottom", "lower.top"))
        assert up == pytest.approx([0.0, 300.0], abs=0.1) and down == pytest.approx(-up, abs=1e-6)
        assert (result.contact.force_n >= 0).all()
    np.testing.assert_array_equal(results[0].displacement, results[1].displacement)
    assert am.discretise(pair(contrast, finer=finer)[0], made[0].finest.mesh).contact.names == (
        slave,
    )


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_sides_of_equal_size_stay_as_they_are_written(angle):
    """Turned, the sizes differ by rounding."""
    parts = am.Assembly(parts=slabs(2, upper=0.0, lower=-0.5))
    mesh = turned(am.mesh.structured(parts, 7), angle)
    for names in (("upper.bottom", "lower.top"), ("lower.top", "upper.bottom")):
        problem = replace(pair(1.0, *names)[0], domain=None)
        assert with_sides(problem, mesh).contact_boundaries == names[:1]


def test_advice_on_a_stiff_slave_does_not_ask_for_what_is_not_possible():
    """A support holds the boundary of the master, so that it cannot carry the contact nodes."""
    problem, sizes = pair(1e3)
    held = replace(problem, supports=(*problem.supports, am.Support("lower.top", x=0.0)))
    for posed, remedy in (
        (replace(problem, contact=replace(problem.contact[0], sides="given")), 'sides="auto"'),
        (held, "cannot be exchanged"),
    ):
        with pytest.warns(UserWarning, match=f"times stiffer than the master.*{remedy}"):
            am.solve(am.Hierarchy.graded(posed, sizes[:1]), throw=False)


def test_another_contrast_on_the_same_meshes_exchanges_the_sides():
    problem, sizes = pair(1e-3)
    grids = am.Hierarchy.graded(problem, sizes)
    again = grids.with_problem(pair(1e3)[0])
    assert grids.problem.contact_boundaries == ("upper.bottom",) != again.problem.contact_boundaries
    fresh = am.Hierarchy.from_meshes(pair(1e3)[0], [level.mesh for level in grids.levels])
    np.testing.assert_array_equal(am.solve(again).displacement, am.solve(fresh).displacement)


@pytest.mark.parametrize(
    "held",
    [
        {"supports": (am.Support("lower.bottom", x=0, y=0), am.Support("lower.top", x=0))},
        {"ties": am.Tied("lower.top", "lower.bottom")},
    ],
    ids=["support", "tie"],
)
def test_a_master_that_a_support_or_tie_holds_stays_master(held):
    problem, sizes = pair(1e3)
    meshes = [level.mesh for level in am.Hierarchy.graded(problem, sizes[:1]).levels]
    sided = with_sides(replace(problem, **held), meshes[0])
    assert sided.contact_boundaries == ("upper.bottom",)


@pytest.mark.parametrize(
    ("contrast", "sides", "loud"),
    [(9.0, "given", False), (11.0, "given", True), (11.0, "auto", False)],
)
def test_a_given_slave_much_stiffer_than_its_master_is_warned_of(contrast, sides, loud, recwarn):
    am.solve(am.Hierarchy.graded(*pair(contrast, sides=sides)))
    assert [
        "11 times stiffer" in str(one.message) and one.filename == __file__ for one in recwarn
    ] == [True] * loud
