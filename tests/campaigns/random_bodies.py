"""Random pairs of bodies for the campaign: a block on a wider one, meshes that do not match."""

from __future__ import annotations

from typing import Any

import numpy as np

import adaptmg as am

SIDE = 40e-3


def random_pair(seed: int) -> tuple[dict[str, Any], am.Hierarchy]:
    """A random problem of two bodies on random meshes, and what it is."""
    rng = np.random.default_rng(seed)
    width = SIDE * float(rng.uniform(1.1, 2))
    height = SIDE * float(rng.uniform(0.4, 1.2))
    left = -float(rng.uniform(0.05, 0.9)) * (width - SIDE)
    parts = {"upper": am.Rectangle(width=SIDE, height=SIDE),
             "lower": am.Rectangle(width=width, height=height, origin=(left, -height))}
    friction = float(rng.choice([0.0, 0.1, 0.3, 0.7, 1.0, 1.5]))
    law = am.Coulomb(friction) if friction else am.Frictionless()
    if rng.random() < 0.2:
        law = am.Tresca(float(10 ** rng.uniform(6.5, 8)))
    young = {name: float(10 ** rng.uniform(10, 11.5)) for name in parts}
    slave = "upper" if rng.random() < 0.5 else "lower"
    faces = ("upper.bottom", "lower.top")
    problem = am.ContactProblem(
        name="two bodies",
        domain=am.Assembly(parts=parts),
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        contact=am.ContactPair(*(faces if slave == "upper" else faces[::-1])),
        law=law,
        loads=(am.Pressure("upper.top", float(rng.uniform(1e7, 1e8))),
               am.Pressure("upper.left", float(rng.uniform(-1e8, 2e8)))),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)),
    )
    nested = bool(rng.random() < 0.5)
    ratio = float(rng.uniform(0.7, 1.5))
    if nested:
        # cells of the lower body about square, larger or smaller than those of the upper one
        n = int(rng.integers(3, 6))
        across, up = (max(1, round(n * length / SIDE * ratio)) for length in (width, height))
        hierarchy = am.Hierarchy.from_meshes(problem, [am.mesh.merged({
            "upper": am.mesh.structured(parts["upper"], n * k),
            "lower": am.mesh.structured(parts["lower"], (across * k, up * k))}) for k in (1, 2, 4, 8)])
    else:
        graded = float(rng.uniform(1, 4))
        sizes = [{"upper": h, "lower": h * ratio} for h in (9e-3, 5.4e-3, 3.2e-3, 1.9e-3)]
        hierarchy = am.Hierarchy.graded(problem, sizes, graded)
    other = "lower" if slave == "upper" else "upper"
    what = {"dim": 2, "nested": nested, "floating": False, "law": type(law).__name__, "friction": friction,
            "slave": slave, "stiffness": young[slave] / young[other], "nodes": hierarchy.finest.n_nodes}
    return what, hierarchy
