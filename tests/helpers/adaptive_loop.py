"""Parts of an adaptive loop that cost nothing, and what its steps computed, bit for bit."""

import numpy as np

import adaptmg as am

__all__ = ["Constant", "numbers_of", "upset"]


class Constant:
    """An indicator that finds the same everywhere, as in a mesh of one's own estimate."""

    def __init__(self, square: float = 1e-4) -> None:
        self.square = square

    def indicate(self, hierarchy: am.Hierarchy, result: am.Result) -> am.Estimate:
        n = len(hierarchy.finest.mesh.elements)
        return am.Estimate(squares=np.full(n, self.square / n), norm=1.0, indicator="constant")

    def __repr__(self) -> str:
        return f"Constant({self.square})"


def upset(friction: float = 0.5) -> am.ContactProblem:
    """The upset block: one body, singular at its foot."""
    return am.cases.upset_block(law=am.Coulomb(friction))


def numbers_of(steps: list[am.Step]) -> list[bytes]:
    """Everything that the steps computed, timings apart."""
    found = []
    for step in steps:
        mesh, work = step.hierarchy.finest.mesh, (step.work_units, step.total_work_units, step.result.rtol)
        levels = [level.n_nodes for level in step.hierarchy.levels]
        history = [array.tobytes() for array in vars(mesh.refinement).values()] if mesh.refinement else []
        found.append(b"".join([*history, step.result.displacement.tobytes(), step.estimate.squares.tobytes(),
                               mesh.points.tobytes(), mesh.elements.tobytes(), np.array(work).tobytes(),
                               np.array(levels).tobytes()]))
    return found
