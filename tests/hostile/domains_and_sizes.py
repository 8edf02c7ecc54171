"""Domains that Netgen or OCC cannot mesh, and sizes that ask for too much."""

from hostile_table import Hostile

import adaptmg as am
from adaptmg.mesh import graded, netgen_guard, sized, solid_mesh, structured

# nobody waits here
netgen_guard.LIMIT_S.update({2: 3.0, 3: 5.0})

SQUARE, CUBE = am.Rectangle(width=1, height=1), am.Box(width=1, depth=1, height=1)
BAD = {"0": 0, "-1": -1.0, "nan": float("nan"), "inf": float("inf"), "True": True, "text": "0.1", "None": None,
       "complex": 1j, "10**400": 10**400, "list": [0.1]}


def _polygon(*vertices: tuple[float, float]) -> am.Polygon:
    return am.Polygon(vertices=vertices, boundaries=tuple("abcdefgh"[:len(vertices)]))


def _thin():
    """Thin parts, for sizes of a tenth or so of the whole."""
    slot = _polygon((0, 0), (.5, 0), (.5, .5), (.500001, .5), (.500001, 0), (1, 0), (1, 1), (0, 1))
    plane = {"rectangle": am.Rectangle(width=1, height=1e-5), "needle": _polygon((0, 0), (1, 0), (1, 1e-4)),
             "slot": slot}
    solid = {"box": am.Box(width=1e-9, depth=1, height=1), "wire": am.Cylinder((0, 0, 0), (0, 0, 1), 1e-6, 1),
             "tube": am.Revolution(_polygon((1, 0), (1.000001, 0), (1.000001, 1), (1, 1))),
             "cut in two": am.Cut(CUBE, am.Box(width=1e-3, depth=2, height=2, origin=(.5, -.5, -.5))),
             "nothing left": am.Cut(CUBE, am.Box(width=3, depth=3, height=3, origin=(-1, -1, -1))),
             "hole": am.Cut(CUBE, am.Cylinder((.5, .5, -1), (0, 0, 1), 1e-6, 3)),
             "moved": am.Moved(am.Cylinder((0, 0, 0), (1, 1, 1), 1, 1e-7), offset=(1, 2, 3), angle=30)}
    far = am.Box(width=1, depth=1, height=1, origin=(5, 0, 0))
    yield Hostile("parts apart", lambda: graded(am.Fuse(CUBE, far), 0.2), "Box", ValueError)
    yield Hostile("nothing in common", lambda: graded(am.Common(CUBE, far), 0.2), "Box", ValueError)
    for label, domain in (plane | solid).items():
        yield Hostile(f"thin {label}", lambda d=domain: graded(d, 0.2), type(domain).__name__, ValueError)


def _sizes():
    for label, size in BAD.items():
        yield Hostile(f"graded size {label}", lambda s=size: graded(SQUARE, s), "size")
        yield Hostile(f"sized max_size {label}", lambda s=size: sized(SQUARE, 0.1, s), "max_size")
        yield Hostile(f"solid size {label}", lambda s=size: solid_mesh(CUBE, s), "size")
        yield Hostile(f"contact_ratio {label}", lambda s=size: graded(SQUARE, 0.3, "top", s), "contact_ratio")
        yield Hostile(f"grading {label}", lambda s=size: graded(SQUARE, 0.3, "top", 2, s), "grading")
    tiny = {"1e-6": 1e-6, "1e-100": 1e-100, "1e-300": 1e-300}
    for label, size in tiny.items():
        yield Hostile(f"square of {label}", lambda s=size: graded(SQUARE, s), "sizes ask for")
        yield Hostile(f"cube of {label}", lambda s=size: graded(CUBE, s), "sizes ask for")
        yield Hostile(f"ball of {label}", lambda s=size: graded(am.Ball((0, 0, 0), 1), s), "sizes ask for")
        yield Hostile(f"field of {label}", lambda s=size: sized(SQUARE, s, 0.3), "size")
    yield Hostile("ratio 1e9", lambda: graded(SQUARE, 0.3, "top", 1e9), "sizes ask for")
    yield Hostile("ratio 1e5 in space", lambda: graded(CUBE, 0.3, "top", 1e5), "sizes ask for")
    yield Hostile("round wire", lambda: solid_mesh(am.Cylinder((0, 0, 0), (0, 0, 1), 1e-4, 1), 1e-2, curvature=20),
                  "sizes ask for")
    for label, field in {"nan": lambda x: x[:, 0] * float("nan"), "negative": lambda x: -x[:, 0] - 1,
                         "zero": lambda x: 0 * x[:, 0], "one number": lambda x: [1.0, 2.0]}.items():
        yield Hostile(f"size_function {label}", lambda f=field: sized(SQUARE, f, 0.3), "size_function")


def _structured():
    for label, n in {"0": 0, "-3": -3, "1.5": 1.5, "True": True, "text": "4", "None": None, "three": (2, 2, 2),
                     "nested": ((1, 2), 3), "10**400": 10**400}.items():
        yield Hostile(f"divisions {label}", lambda n=n: structured(SQUARE, n), "divisions")
    for label, n in {"10**5": 10**5, "10**9": 10**9, "2**40": 2**40}.items():
        yield Hostile(f"divisions {label}", lambda n=n: structured(SQUARE, n), "divisions")
        yield Hostile(f"divisions {label} in space", lambda n=n: structured(CUBE, n), "divisions")
    yield Hostile("diagonal", lambda: structured(SQUARE, 2, "up"), "diagonal")
    for label, domain in {"None": None, "text": "square", "class": am.Rectangle, "number": 3}.items():
        yield Hostile(f"structured {label}", lambda d=domain: structured(d, 2), "domain")
        yield Hostile(f"graded {label}", lambda d=domain: graded(d, 0.1), "domain")


INPUTS = (*_thin(), *_sizes(), *_structured())
