"""The benchmark problems by name, each with a description and its call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from adaptmg import _checks as checks
from adaptmg.cases.blocks import incline, leaning_strut, two_block_patch
from adaptmg.cases.bolts import bolted_junction
from adaptmg.cases.closed_forms import (
    cattaneo,
    flat_punch,
    hertz_cylinder,
    hertz_sphere,
)
from adaptmg.cases.impact import impact_bar
from adaptmg.cases.paper import curved_obstacle, dovetail, greco_bar, greco_block, upset_block
from adaptmg.cases.plastic_bodies import (
    hill_cylinder,
    prandtl_punch,
)
from adaptmg.cases.scalar import elastic_plastic_torsion, obstacle_problem
from adaptmg.cases.transition import coulomb_transition


@dataclass(frozen=True)
class Case:
    """A benchmark case: a function with defaults for all arguments, and its description in one
    line.

    Examples
    --------
    >>> am.cases.CASES["dovetail"].function().name
    'dovetail'
    """

    #: returns a ContactProblem, or a ScalarProblem where ``call`` says how it is solved
    function: Callable[..., Any]
    description: str
    #: in Python the call that solves ``problem``; empty where the command line does it
    call: str = ""


CASES: Mapping[str, Case] = MappingProxyType(
    {
        "greco_bar": Case(
            greco_bar, "square pressed on a plane and pushed along it, Coulomb friction 1 (2D)"
        ),
        "curved_obstacle": Case(
            curved_obstacle, "the same square in front of a curved obstacle, frictionless (2D)"
        ),
        "upset_block": Case(
            upset_block, "square squeezed on a plane, friction 0.5: singular foot (2D)"
        ),
        "greco_block": Case(greco_block, "the GRECO bar as a solid (3D)"),
        "dovetail": Case(
            dovetail, "a tongue pulled out of its notch, Coulomb friction 0.2: two bodies (2D)"
        ),
        "bolted_junction": Case(
            bolted_junction, "two bolted flanges under internal pressure (axisymmetric; 3D sector)"
        ),
        "hertz_cylinder": Case(
            hertz_cylinder, "a cylinder on a block or another cylinder, closed form of Hertz (2D)"
        ),
        "hertz_sphere": Case(
            hertz_sphere,
            "a ball on a block or another ball, closed form of Hertz (axisymmetric, 3D)",
        ),
        "cattaneo": Case(
            cattaneo, "a cylinder pressed on a block, then pulled sideways: partial slip (2D)"
        ),
        "coulomb_transition": Case(
            coulomb_transition, "the end of a slip zone, with its exact field r^lambda (2D)"
        ),
        "flat_punch": Case(
            flat_punch, "a flat rigid punch on a block, frictionless: singular edge (2D)"
        ),
        "incline": Case(
            incline, "a block on a tilted slab, held by friction alone: two bodies (2D)"
        ),
        "leaning_strut": Case(
            leaning_strut, "a strut that leans on its foot, friction 0.6: three solutions (2D)"
        ),
        "two_block_patch": Case(
            two_block_patch, "two blocks under uniform stress: the patch test of contact (2D, 3D)"
        ),
    }
)

#: cases in time, along a load path or with one unknown a node, which the command line lists only
FROM_PYTHON: Mapping[str, Case] = MappingProxyType(
    {
        "impact_bar": Case(
            impact_bar,
            "a bar that hits a rigid wall and rebounds, closed form (2D, in time)",
            "am.march(am.Hierarchy.uniform(problem, ((1, 10), (2, 20))), "
            "am.Dynamics(density=1.0, initial_velocity=(0.0, -10.0), step=0.02, end=1.5))",
        ),
        "prandtl_punch": Case(
            prandtl_punch,
            "a flat punch on a block that yields, limit load of Prandtl (2D)",
            'am.solve_path(am.Hierarchy.graded(problem), am.LoadPath({"punch": [0.5, 1.0]}))',
        ),
        "hill_cylinder": Case(
            hill_cylinder,
            "a thick tube that yields under inner pressure, closed form of Hill (2D)",
            "am.solve_path(am.Hierarchy.uniform(problem, ((20, 5), (40, 10))), "
            'am.LoadPath({"left": [0.9, 1.0, 0.0]}))',
        ),
        "obstacle_problem": Case(
            obstacle_problem,
            "a round membrane pressed on a floor, closed form (scalar)",
            "am.solve(am.Hierarchy.graded(problem, (0.2, 0.1, 0.05)))",
        ),
        "elastic_plastic_torsion": Case(
            elastic_plastic_torsion,
            "a twisted bar that yields, round (closed form) or square (scalar)",
            "am.solve(am.Hierarchy.graded(problem, (0.2, 0.1, 0.05)))",
        ),
    }
)


def get(name: str) -> Case:
    """Return the case of a name; ValueError lists the names.

    >>> get("greco_bar").function(poisson=0.3).material.poisson
    0.3
    """
    cases = {**CASES, **FROM_PYTHON}
    if checks.boundary_name("name", name) not in cases:
        raise ValueError(
            f"there is no case {name!r}{checks.suggestion(name, cases)}; the cases are "
            f"{', '.join(cases)}"
        )
    return cases[name]
