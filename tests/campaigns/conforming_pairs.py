"""Random conforming pairs with rims that do not match: peaks of pressure against matching fine
meshes.

A pin in its bush, a bead in its groove (axisymmetric), a ball in its cup (axisymmetric), at random
sizes, clearances down to none, contrasts of moduli and edges on both rims. The inner body is moved
against the outer one, by one to four clearances.

    python tests/campaigns/conforming_pairs.py --count 60
"""

from __future__ import annotations

import warnings

import campaign
import numpy as np
import pandas as pd

import adaptmg as am

#: of the peak on the fine mesh
_TOLERANCE = 0.05
_KINDS = ("pin", "bead", "cup")
#: edges around a whole fine rim
_FINE = 320


def _rings(r: float, fit: float, centre: np.ndarray) -> dict[str, am.Outline]:
    """Two rings, the outer one around the inner one."""

    def ring(a: float, b: float, inside: str, outside: str) -> am.Cut:
        return am.Cut(am.Circle(centre, b, outside), am.Circle(centre, a, inside))

    return {"inner": ring(0.5 * r, r, "held", "rim"), "outer": ring(fit, 2 * r, "hole", "held")}


def _halves(r: float, fit: float, centre: np.ndarray) -> dict[str, am.Outline]:
    """Two lower half rings, which end on the axis below and at the height of the centre."""

    def half(a: float, b: float, inside: str, outside: str) -> am.Outline:
        x, y = centre
        return am.Outline(
            vertices=((x, y - b), (x + b, y), (x + a, y), (x, y - a)),
            boundaries=(outside, "end", inside, "axis"),
            arcs={0: (x, y), 2: (x, y)},
        )

    return {"inner": half(0.5 * r, r, "held", "rim"), "outer": half(fit, 2 * r, "hole", "held")}


def _posed(rng: np.random.Generator) -> tuple[am.ContactProblem, float, str]:
    kind = _KINDS[rng.integers(len(_KINDS))]
    r = 10 ** rng.uniform(-3, -1)
    clearance = r * 10 ** rng.uniform(-4, -2)
    down = clearance * rng.uniform(1.3, 4)
    centre = r * rng.uniform(-5, 5, size=2)
    turn = rng.uniform(0, 2 * np.pi)
    if kind != "pin":
        turn = 0.0
        centre[0] = 4 * r if kind == "bead" else 0.0
    parts = (_halves if kind == "cup" else _rings)(r, r + clearance, centre)
    material = am.PlaneStrain if kind == "pin" else am.Axisymmetric
    moduli = 10 ** rng.uniform(9, 11.3, size=2)
    supports = [
        am.Support("inner.held", x=down * np.sin(turn), y=-down * np.cos(turn)),
        am.Support("outer.held", x=0, y=0),
    ]
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material={
            name: material(young=young, poisson=0.3)
            for name, young in zip(parts, moduli, strict=True)
        },
        contact=am.ContactPair("inner.rim", "outer.hole", sides="auto"),
        law=am.Frictionless(),
        supports=supports,
    )
    return problem, r, kind


def _peak(problem: am.ContactProblem, sizes: dict[str, float]) -> tuple[float, list[int]]:
    mesh = am.mesh.graded(problem.domain, sizes, ("inner.rim", "outer.hole"))
    result = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), am.ActiveSet(rtol=1e-6))
    edges = [len(mesh.boundary_nodes(name)) for name in ("inner.rim", "outer.hole")]
    pressure, away = result.contact.pressure, result.contact.x[:, 0]
    if isinstance(problem.material["inner"], am.Axisymmetric):
        pressure = pressure[away > 1e-9 * away.max()]
    return float(pressure.max()), edges


def measure(seed: int) -> dict[str, object]:
    """Return the peak of one pair on rims that do not match, and on fine ones that do."""
    rng = np.random.default_rng(seed)
    problem, r, kind = _posed(rng)
    edges = rng.integers(48, 140)
    other = edges * rng.choice([rng.uniform(0.55, 0.9), rng.uniform(1.1, 1.8)])
    row: dict[str, object] = {"kind": kind, "radius": r}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            rims = {"inner": 2 * np.pi * r / edges, "outer": 2 * np.pi * r / other}
            peak, row["edges"] = _peak(problem, rims)
            right, _ = _peak(problem, dict.fromkeys(rims, 2 * np.pi * r / _FINE))
        except Exception as error:
            return row | {"faults": f"{type(error).__name__}: {error}"[:200]}
    row |= {"peak": peak, "right": right, "error": peak / right - 1}
    return row | {"faults": f"{row['error']:+.3f}" if abs(row["error"]) > _TOLERANCE else ""}


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return the largest errors by kind."""
    found = table.assign(size=table["error"].abs()).groupby("kind")["size"]
    return found.describe(percentiles=[0.5, 0.9]).reset_index()


if __name__ == "__main__":
    campaign.main(measure, summary, range(60))
