"""Domains that Netgen or OCC cannot mesh."""

from unittest import mock

from hostile_table import Hostile

import adaptmg as am
from adaptmg.mesh import netgen_guard

CUBE = am.Box(width=1, depth=1, height=1)
RECTANGLE = am.Polygon(
    vertices=((1, 0), (1.000001, 0), (1.000001, 1), (1, 1)), boundaries=tuple("abcd")
)


@mock.patch.dict(netgen_guard.LIMIT_S, {3: 1.0})
def _meshed(domain):
    am.mesh.graded(domain, 0.2)


def _thin():
    """Thin parts, for sizes of a tenth or so of the whole."""
    thin = {
        "box": am.Box(width=1e-9, depth=1, height=1),
        "wire": am.Cylinder((0, 0, 0), (0, 0, 1), 1e-6, 1),
        "tube": am.Revolution(RECTANGLE),
        "cut in two": am.Cut(CUBE, am.Box(width=1e-3, depth=2, height=2, origin=(0.5, -0.5, -0.5))),
        "nothing left": am.Cut(CUBE, am.Box(width=3, depth=3, height=3, origin=(-1, -1, -1))),
        "hole": am.Cut(CUBE, am.Cylinder((0.5, 0.5, -1), (0, 0, 1), 1e-6, 3)),
        "moved": am.Moved(am.Cylinder((0, 0, 0), (1, 1, 1), 1, 1e-7), offset=(1, 2, 3), angle=30),
    }
    far = am.Box(width=1, depth=1, height=1, origin=(5, 0, 0))
    yield Hostile("parts apart", lambda: _meshed(am.Fuse(CUBE, far)), "Box", ValueError)
    yield Hostile("nothing in common", lambda: _meshed(am.Common(CUBE, far)), "Box", ValueError)
    for label, domain in thin.items():
        part = {"hole": "Cylinder", "moved": "Cylinder"}.get(label, type(domain).__name__)
        yield Hostile(f"thin {label}", lambda d=domain: _meshed(d), part, ValueError)


INPUTS = tuple(_thin())
