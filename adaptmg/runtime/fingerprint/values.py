"""Values as text: equal texts where a function cannot tell the values apart.

Numbers, texts and containers of them by what they hold, arrays by their bytes, other objects by their class and the
state that they would be pickled with. What has no such state (open files, locks, generators) and generators of random
numbers, whose state the runs would change, have no text: :class:`NoText`.
"""

from __future__ import annotations

import copyreg
import ctypes
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
            # in another order sums are rounded otherwise
            order = " by columns" if value.flags.fnc else ""
            kind = f"{value.dtype.str} {value.dtype.descr if value.dtype.names else ''}"
            return f"array {kind} {value.shape}{order} {_bytes_hash(value)}"
        if type(value) in (tuple, list):
            return f"{type(value).__name__}({', '.join(map(self.of, value))})"
        if type(value) in (set, frozenset):
            return f"{type(value).__name__}({', '.join(sorted(map(self.of, value)))})"
        if type(value) in (dict, types.MappingProxyType):
            return f"dict({', '.join(f'{self.of(key)}: {self.of(item)}' for key, item in value.items())})"
        if isinstance(value, _RANDOM):
            raise NoText("a generator of random numbers, which runs would share and change: make one in the function, "
                         "from a seed that is a parameter")
        wrapped = _wrapped(value)
        if wrapped is not None:
            return f"{type(value).__name__} of {self.of(wrapped[0])} {self.of(wrapped[1])}"
        if isinstance(value, types.MethodType):
            return f"method {self.of(value.__func__)} of {self.of(value.__self__)}"
        if type(value) is functools.partial:
            return f"partial {self.of(value.func)} {self.of(value.args)} {self.of(value.keywords)}"
        if type(value) in (staticmethod, classmethod):
            return f"{type(value).__name__} {self.of(value.__func__)}"
        if type(value) is functools.cached_property:  # holds a lock
            return f"property {self.of(value.func)}"
        if type(value) is property:
            return f"property {self.of((value.fget, value.fset, value.fdel))}"
        if isinstance(value, ctypes.CDLL):
            raise NoText("a library of C, which may be any: load it in the function, and name its file with depends=")
        if isinstance(value, np.ufunc) and value.__name__.endswith("(vectorized)"):
            raise NoText("numpy does not say of which function it was made")
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
        parts = [self.of(_without_caches(type(value), part)) for part in reduced[:3]]
        parts += [self.of(list(part)) for part in reduced[3:5] if part is not None]
        return f"object {' '.join(parts)}"


def _bytes_hash(array: np.ndarray) -> str:
    """Of the content, which is not copied where it lies in one piece."""
    whole = np.ascontiguousarray(array)
    try:
        return hashlib.sha256(whole.reshape(-1).view(np.uint8)).hexdigest()
    except (TypeError, ValueError):  # items of no bytes
        return hashlib.sha256(whole.tobytes()).hexdigest()


def _wrapped(value: Any) -> tuple[types.FunctionType, Any] | None:
    """The function inside one that is compiled by numba or has a cache, and the options of that."""
    if isinstance(value, functools._lru_cache_wrapper):
        inner, options = value.__wrapped__, value.cache_parameters()["typed"]
    elif any(kind.__module__.startswith("numba.") for kind in type(value).__mro__):
        inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
        options = {key: repr(option) for key, option in sorted(getattr(value, "targetoptions", {}).items())}
    else:
        return None
    return (inner, options) if isinstance(inner, types.FunctionType) else None


def _without_caches(kind: type, state: Any) -> Any:
    """A state without what follows from the rest, and is there once it was asked for."""
    if type(state) is not dict:
        return state
    kept = [name for name in state if isinstance(name, str) and any(
        isinstance(vars(owner).get(name), functools.cached_property) for owner in kind.__mro__)]
    return {name: value for name, value in state.items() if name not in kept} or None if kept else state
