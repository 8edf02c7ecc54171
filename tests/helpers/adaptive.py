"""Parts of an adaptive loop that cost nothing: small problems, an engine that bisects, a child that runs a loop."""

from __future__ import annotations

import numpy as np

import adaptmg as am
from adaptmg.mesh import bisect

__all__ = ["Halving", "numbers_of", "upset"]


class Halving:
    """Bisects what is marked until the mesh has grown by a third; remembers how often it was asked."""

    def __init__(self, theta: float = 0.6) -> None:
        self.theta, self.asked = theta, 0

    def refine(self, problem: am.ContactProblem, mesh: am.MeshArrays, estimate: am.Estimate, marked: np.ndarray,
               max_nodes: int | None = None) -> am.MeshArrays:
        self.asked += 1
        return bisect(mesh, marked)[0]

    def __repr__(self) -> str:
        return f"Halving({self.theta})"


def upset(friction: float = 0.5) -> am.ContactProblem:
    """The upset block: one body, singular at its foot."""
    return am.cases.upset_block(law=am.Coulomb(friction))


def numbers_of(steps: list[am.Step]) -> list[bytes]:
    """Everything that the steps computed, timings apart, bit for bit."""
    return [b"".join([step.result.displacement.tobytes(), step.estimate.squares.tobytes(),
                      step.hierarchy.finest.mesh.points.tobytes(), step.hierarchy.finest.mesh.elements.tobytes(),
                      np.array([step.total_work_units, step.result.rtol, *map(len, (step.hierarchy,))]).tobytes()])
            for step in steps]
