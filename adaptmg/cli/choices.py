"""Names that options take."""

from __future__ import annotations

from enum import StrEnum

__all__ = [
    "CorrectionName",
    "EngineName",
    "GoalName",
    "IndicatorName",
    "LawName",
    "LinearName",
    "MarkName",
    "Shape",
    "SolverName",
    "Sweeping",
    "TransferName",
]


class SolverName(StrEnum):
    """Methods."""

    FULL = "full-multigrid"
    MULTIGRID = "multigrid"
    SINGLE = "single-grid"
    ACTIVE = "active-set"


class LawName(StrEnum):
    """Contact laws."""

    FRICTIONLESS = "frictionless"
    COULOMB = "coulomb"
    TRESCA = "tresca"


class TransferName(StrEnum):
    """Transfers between non-nested grids."""

    INTERPOLATION = "interpolation"
    L2 = "l2"
    LUMPED = "lumped-l2"
    PSEUDO = "pseudo-l2"
    QUASI = "quasi-interpolation"


class CorrectionName(StrEnum):
    """Multigrid corrections."""

    TRUNCATED = "truncated"
    MONOTONE = "monotone"
    PAPER = "paper"


class Shape(StrEnum):
    """Shapes of multigrid cycles."""

    V = "V"
    W = "W"
    F = "F"
    COMPLETE = "complete"


class LinearName(StrEnum):
    """Linear solvers inside the active set method."""

    DIRECT = "direct"
    AMG = "amg"


class EngineName(StrEnum):
    """What makes the next mesh of an adaptive loop."""

    REMESH = "remesh"
    BISECT = "bisect"


class IndicatorName(StrEnum):
    """Error indicators."""

    RESIDUAL = "residual"
    RECOVERY = "recovery"


class GoalName(StrEnum):
    """Quantities whose error an adaptive loop follows."""

    DISPLACEMENT = "displacement"
    MEAN_DISPLACEMENT = "mean-displacement"
    CONTACT_FORCE = "contact-force"
    OPENING = "opening"


class MarkName(StrEnum):
    """What marks elements."""

    DOERFLER = "doerfler"
    MAXIMUM = "maximum"


class Sweeping(StrEnum):
    """Order of the nodes in a sweep."""

    FORWARD = "forward"
    BACKWARD = "backward"
    SYMMETRIC = "symmetric"
