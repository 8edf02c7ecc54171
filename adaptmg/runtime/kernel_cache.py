"""Compiled kernels where nothing can be written, and with a damaged or full cache: slower, but they run.

numba keeps compiled functions beside their source or in the home directory. Where neither can be written it refuses to
compile them at all ("no locator available"); then they are kept in the directory of temporary files, or nowhere. A
cache file that cannot be read is taken for missing, and one that cannot be written (a full disk) is left out. Each
time a warning is logged. Functions of other packages stay as numba has them.
"""

from __future__ import annotations

import importlib.abc
import importlib.util
import logging
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

__all__ = ["install"]

_log = logging.getLogger(__name__)
_MODULE = "numba.core.caching"
_ROOT = str(Path(__file__).parents[1]) + os.sep
#: stands for no place at all
_NOWHERE = os.path.join(os.devnull, "adaptmg-kernels")


def install() -> None:
    """Have numba do so; when it is loaded, since adaptmg does not load it before it is needed."""
    if _MODULE in sys.modules:
        _mend(sys.modules[_MODULE])
    elif not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


class _Finder(importlib.abc.MetaPathFinder):
    """Mends the one module when it is imported."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != _MODULE:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                run(module)
                _mend(module)

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _mend(caching: ModuleType) -> None:
    """Change the cache of functions; a numba that is built otherwise is left alone."""
    cache = getattr(caching, "FunctionCache", None)
    locators = getattr(getattr(caching, "CacheImpl", getattr(caching, "_CacheImpl", None)), "_locator_classes", None)
    base = next((getattr(caching, name) for name in ("UserProvidedCacheLocator", "_UserProvidedCacheLocator")
                 if hasattr(caching, name)), None)
    if cache is None or locators is None or base is None or getattr(cache, "mended_by_adaptmg", False):
        return
    cache.load_overload = _tolerant(cache.load_overload, "read", "compiled anew", _forget)
    cache.save_overload = _tolerant(cache.save_overload, "written", "compiled again in the next process")
    cache.mended_by_adaptmg = True
    locators.append(_locator(base))


def _tolerant(method: Callable[..., Any], done: str, outcome: str,
              after: Callable[[Any], None] | None = None) -> Callable[..., Any]:
    """A method of a cache that, for kernels of adaptmg, logs what goes wrong and goes on without."""
    def tolerant(self: Any, *arguments: Any) -> Any:
        function = getattr(self, "_py_func", None)
        if not getattr(function, "__module__", "").startswith("adaptmg."):
            return method(self, *arguments)
        if self.cache_path.startswith(_NOWHERE):
            return None
        try:
            return method(self, *arguments)
        except Exception as error:  # whatever a damaged pickle or a full disk raises
            _log.warning("the cache of the kernel %s in %s cannot be %s (%s: %s): it is %s",
                         function.__qualname__, self.cache_path, done, type(error).__name__, error, outcome)
            if after is not None:
                after(self)
            return None

    return tolerant


def _forget(cache: Any) -> None:
    """Remove the index of a function, so that what is compiled now can be kept under a new one."""
    try:
        os.unlink(cache._cache_file._index_path)
    except (OSError, AttributeError):
        return


def _locator(base: type) -> type:
    """A class of locators, of numba's kind, for kernels of adaptmg that no other locator has a place for."""
    class TemporaryLocator(base):  # type: ignore[misc, valid-type]
        """Points into the directory of temporary files."""

        def __init__(self, function: Any, file: str) -> None:
            super().__init__(function, file)
            self._cache_path = os.path.join(_temporary(), self.get_suitable_cache_subpath(file))

        @classmethod
        def from_function(cls, function: Any, file: str) -> Any:
            # without a check that it can be written: numba would refuse to compile
            return cls(function, file) if file.startswith(_ROOT) else None

    return TemporaryLocator


@lru_cache(maxsize=1)
def _temporary() -> str:
    """A directory of this user alone, as compiled code is run from it; _NOWHERE if none can be made."""
    try:
        place = Path(tempfile.gettempdir(), f"adaptmg-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}")
        place.mkdir(mode=0o700, exist_ok=True)
        found = place.lstat()
        if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "getuid") and (found.st_uid != os.getuid()
                                                                          or stat.S_IMODE(found.st_mode) & 0o077)):
            place = Path(tempfile.mkdtemp(prefix="adaptmg-kernels-"))
        tempfile.TemporaryFile(dir=place).close()
    except OSError as error:
        _log.warning("compiled kernels are not kept, as nothing can be written (%s): set NUMBA_CACHE_DIR to a "
                     "directory that can", error)
        return _NOWHERE
    _log.warning("compiled kernels are kept in %s, as neither the package nor the home directory can be written: set "
                 "NUMBA_CACHE_DIR to keep them elsewhere", place)
    return str(place)
