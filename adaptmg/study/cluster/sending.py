"""Run functions as bytes: by value what has no module on a worker (scripts, notebooks, closures), else by name."""

from __future__ import annotations

import functools
import io
import pickle
from collections.abc import Callable
from typing import Any

import cloudpickle

__all__ = ["received", "sent"]

_MOST = 50 * 2**20


class _Pickler(cloudpickle.Pickler):
    """Cached functions of ``__main__`` too, which cloudpickle would look for in the ``__main__`` of the worker."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, functools._lru_cache_wrapper) and getattr(obj, "__module__", None) == "__main__":
            return _cached_again, (obj.__wrapped__, obj.cache_parameters())
        return super().reducer_override(obj)


def _cached_again(function: Callable[..., Any], parameters: dict[str, Any]) -> Any:
    return functools.lru_cache(**parameters)(function)


def sent(function: Callable[..., Any]) -> bytes:
    """A function as bytes.

    Raises
    ------
    TypeError
        If it cannot be sent, or carries too much with it.
    """
    buffer = io.BytesIO()
    try:
        _Pickler(buffer).dump(function)
    except Exception as error:  # whatever the objects it carries raise
        raise TypeError(f"the run function {function.__qualname__} cannot be sent to a worker, as something it reads "
                        f"cannot ({type(error).__name__}: {error}): build that inside the function") from error
    content = buffer.getvalue()
    if len(content) > _MOST:
        raise TypeError(f"the run function {function.__qualname__} carries {len(content) / 1e6:.0f} MB of values with "
                        "it, with each run: let it read them from a file, or build them")
    return content


def received(content: bytes) -> Callable[..., Any]:
    """The function again."""
    return pickle.loads(content)
