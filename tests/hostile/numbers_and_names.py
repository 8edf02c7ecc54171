"""Numbers, names and choices as arguments of problems."""

from hostile_table import Hostile

import adaptmg as am

_NOT_NUMBERS = {"True": True,
                "text": "1", "bytes": b"1", "complex": 1j, "None": None, "list": [1.0], "nan": float("nan"),
                "inf": float("inf"), "class": float, "huge": 10**400}


def _numbers():
    for label, value in _NOT_NUMBERS.items():
        if label != "None":
            yield Hostile(f"support x={label}", lambda v=value: am.Support("right", x=v), "x")
        yield Hostile(f"width {label}", lambda v=value: am.Rectangle(width=v, height=1.0), "width")


INPUTS = tuple(_numbers())
