"""Values compared, and what a run of a study takes over from the runs before it.

The runs of a study often differ in law, load or material alone: their meshes and matrices are then the same. Each
thread keeps the last few objects that are expensive to make and that a run made there, under values that say what they
are, and later runs on this thread find them.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np


def same(a: object, b: object) -> bool:
    """Whether two parts of problems have the same values."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if is_dataclass(a):
        return all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    return bool(a == b)


def plain(value: object) -> bool:
    """Whether a value says all by itself: functions, files and objects of other modules may change unseen."""
    if value is None or isinstance(value, bool | int | float | str | np.ndarray | np.number):
        return True
    if isinstance(value, tuple):
        return all(map(plain, value))
    if isinstance(value, Mapping):
        return all(map(plain, value.values()))
    own = type(value).__module__.partition(".")[0] == __name__.partition(".")[0]
    return own and is_dataclass(value) and all(plain(getattr(value, one.name)) for one in fields(value))


@dataclass(eq=False)
class _Kept:
    """An object that a run made."""

    run: int  # number of the run
    key: tuple
    size: int
    made: Any


class _Recent(threading.local):
    """The objects that the runs of this thread made, last used last."""

    #: objects, and their sizes together (nodes), at most
    MOST, SIZE = 3, 200_000

    def __init__(self) -> None:
        self.on, self.run = False, 0
        self.kept: list[_Kept] = []

    def find(self, key: tuple) -> Any:
        """The object that an earlier run made under ``key``, or None. One of this run is not found: a run that measures
        how long something takes may repeat it."""
        one = self._of(key)
        if one is None or one.run == self.run:
            return None
        self.kept.remove(one)
        self.kept.append(one)
        return one.made

    def keep(self, key: tuple, size: int, made: object) -> None:
        """Keep an object, in place of one of the same key; those used longest ago make room."""
        if not (self.on and size <= self.SIZE and plain(key)):
            return
        one = self._of(key)
        if one is None:
            self.kept.append(_Kept(self.run, copy.deepcopy(key), size, made))
        else:
            one.made = made
        while len(self.kept) > self.MOST or sum(one.size for one in self.kept) > self.SIZE:
            del self.kept[0]

    def _of(self, key: tuple) -> _Kept | None:
        return next((one for one in self.kept if same(one.key, key)), None) if self.on else None


recent = _Recent()


@contextmanager
def taken_over() -> Iterator[None]:
    """Let a run take over what earlier ones on this thread made, in a with statement."""
    before, recent.on = recent.on, True
    recent.run += 1
    try:
        yield
    finally:
        recent.on = before
