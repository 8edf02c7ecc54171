"""Values as text: equal texts where a function cannot tell the values apart.

Numbers, texts and containers of them by what they hold, arrays by their bytes, other objects by their class and the
state that they would be pickled with. What has no such state (open files, locks, generators) and generators of random
numbers, whose state the runs would change, have no text: :class:`NoText`.
"""

from __future__ import annotations

import copyreg
import functools
import hashlib
import random
import types
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["NoText", "Texts"]

_PLAIN = (type(None), bool, int, float, complex, str, bytes, bytearray, type(Ellipsis), type(NotImplemented))
_RANDOM = (np.random.Generator, np.random.RandomState, np.random.BitGenerator, random.Random)
_FUNCTIONS = (types.FunctionType, types.BuiltinFunctionType, type, types.ModuleType)


class NoText(TypeError):
    """A value that cannot be told from another; the message says why."""


class Texts:
    """Texts of values.

    Parameters
    ----------
    refer : callable
        Function, class or module -> text: what stands for it.
    """

    def __init__(self, refer: Callable[[Any], str]) -> None:
        self._refer = refer
        self._inside: dict[int, int] = {}

    def of(self, value: Any) -> str:
        """The text of a value."""
        if type(value) in _PLAIN:
            return f"{type(value).__name__} {bytes(value)!r}" if type(value) is bytearray else \
                f"{type(value).__name__} {value!r}"
        if id(value) in self._inside:
            return f"again {len(self._inside) - self._inside[id(value)]}"
        self._inside[id(value)] = len(self._inside)
        try:
            return self._object(value)
        finally:
            del self._inside[id(value)]

    def _object(self, value: Any) -> str:
        if isinstance(value, _FUNCTIONS):
            return self._function(value)
        if isinstance(value, np.ndarray) and not value.dtype.hasobject and type(value) is np.ndarray:
            content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
            return f"array {value.dtype.str} {value.dtype.descr if value.dtype.names else ''} {value.shape} {content}"
        if type(value) in (tuple, list):
            return f"{type(value).__name__}({', '.join(map(self.of, value))})"
        if type(value) in (set, frozenset):
            return f"{type(value).__name__}({', '.join(sorted(map(self.of, value)))})"
        if type(value) in (dict, types.MappingProxyType):
            return f"dict({', '.join(f'{self.of(key)}: {self.of(item)}' for key, item in value.items())})"
        if isinstance(value, _RANDOM):
            raise NoText("a generator of random numbers, which runs would share and change: make one in the function, "
                         "from a seed that is a parameter")
        wrapped = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
        if isinstance(wrapped, types.FunctionType):  # compiled, or with a cache
            return f"{type(value).__name__} of {self.of(wrapped)}"
        if isinstance(value, types.MethodType):
            return f"method {self.of(value.__func__)} of {self.of(value.__self__)}"
        if isinstance(value, functools.partial):
            return f"partial {self.of(value.func)} {self.of(value.args)} {self.of(value.keywords)}"
        if isinstance(value, staticmethod | classmethod):
            return f"{type(value).__name__} {self.of(value.__func__)}"
        if isinstance(value, functools.cached_property):  # holds a lock
            return f"property {self.of(value.func)}"
        if isinstance(value, property):
            return f"property {self.of((value.fget, value.fset))}"
        return self._state(value)

    def _function(self, value: Any) -> str:
        owner = getattr(value, "__self__", None)
        if isinstance(value, types.BuiltinFunctionType) and owner is not None \
                and not isinstance(owner, types.ModuleType | type):
            return f"method {value.__name__} of {self.of(owner)}"
        return self._refer(value)

    def _state(self, value: Any) -> str:
        """Class and state, as they would be pickled."""
        try:
            reduce = copyreg.dispatch_table.get(type(value))
            reduced = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:
            raise NoText(f"{type(value).__name__}: {error}") from error
        if isinstance(reduced, str):
            return f"{self._refer(type(value))} {reduced}"
        parts = [self.of(part) for part in reduced[:3]]
        parts += [self.of(list(part)) for part in reduced[3:5] if part is not None]
        return f"object {' '.join(parts)}"
