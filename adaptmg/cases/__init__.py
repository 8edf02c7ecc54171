"""Benchmark problems: functions that return a ContactProblem with reference values and their
sources."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from adaptmg import _checks as checks
from adaptmg.cases.blocks import incline, leaning_strut, two_block_patch
from adaptmg.cases.bolted_junction import Flanges, bolted_junction
from adaptmg.cases.closed_forms import (
    HertzContact,
    PartialSlip,
    cattaneo,
    flat_punch,
    hertz_cylinder,
    hertz_sphere,
)
from adaptmg.cases.coulomb_transition import TransitionField, coulomb_transition
from adaptmg.cases.impact import impact_bar
from adaptmg.cases.paper import curved_obstacle, dovetail, greco_bar, greco_block, upset_block
from adaptmg.cases.plastic_bodies import hill_cylinder, prandtl_punch, upset_billet
from adaptmg.cases.scalar import elastic_plastic_torsion, obstacle_problem
from adaptmg.problem import ContactProblem

__all__ = [
    "CASES",
    "Case",
    "Flanges",
    "HertzContact",
    "PartialSlip",
    "TransitionField",
    "bolted_junction",
    "cattaneo",
    "coulomb_transition",
    "curved_obstacle",
    "dovetail",
    "elastic_plastic_torsion",
    "flat_punch",
    "get",
    "greco_bar",
    "greco_block",
    "hertz_cylinder",
    "hertz_sphere",
    "hill_cylinder",
    "impact_bar",
    "incline",
    "leaning_strut",
    "obstacle_problem",
    "prandtl_punch",
    "two_block_patch",
    "upset_billet",
    "upset_block",
]


@dataclass(frozen=True)
class Case:
    """A benchmark case: a function with defaults for all arguments, and its description in one
    line.

    Examples
    --------
    >>> am.cases.CASES["dovetail"].function().name
    'dovetail'
    """

    function: Callable[..., ContactProblem]
    description: str


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


def get(name: str) -> Case:
    """Return the case of a name; ValueError lists the names.

    >>> get("greco_bar").function(poisson=0.3).material.poisson
    0.3
    """
    if checks.boundary_name("name", name) not in CASES:
        raise ValueError(
            f"there is no case {name!r}{checks.suggestion(name, CASES)}; the cases are "
            f"{', '.join(CASES)}"
        )
    return CASES[name]


def __dir__() -> list[str]:
    return __all__
