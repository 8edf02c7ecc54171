"""Modules as parts of a fingerprint: installed ones by their version, the user's own by their text."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from adaptmg.runtime.fingerprint.loaded import edited, set_values
from adaptmg.runtime.fingerprint.origin import ADAPTMG, INSTALLED, is_installed, kind_of, version_of
from adaptmg.runtime.fingerprint.own_module import OwnText, own_text

__all__ = ["Modules", "text_hash"]


def text_hash(text: str) -> str:
    """16 hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]


class Modules:
    """Adds parts for modules.

    Parameters
    ----------
    parts : dict
        What is found goes here.
    of_adaptmg : callable
        Told the names of adaptmg that are imported.
    set_in_module : callable
        Told a module's name, values that count, and whether they are all it has.
    """

    def __init__(self, parts: dict[str, str], of_adaptmg: Callable[[str], None],
                 set_in_module: Callable[[str, Mapping[str, Any], bool], None]) -> None:
        self._parts, self._of_adaptmg, self._set_in_module = parts, of_adaptmg, set_in_module

    def imported(self, name: str, inside: str, unless_installed: bool = False) -> None:
        """What is imported inside a function, or by a module that is used whole.

        Parameters
        ----------
        name : str
            A module, or a name in one.
        inside : str
            The package in which a relative name is looked up.
        unless_installed : bool
            Look for the user's own alone: the name may be any text.
        """
        if not name:
            return
        if kind_of(name.split(".")[0]) == ADAPTMG:
            if not unless_installed:
                self._of_adaptmg(name)
            return
        if name.split(".")[0] in sys.stdlib_module_names:
            return
        # 'from package import name': the name may be no module
        wanted = [name, f"{inside}.{name}" if inside else "", name.rpartition(".")[0]]
        spec = next((found for full in wanted if (found := _spec(full)) is not None), None)
        if spec is None:
            if sys.modules.get(name) is not None and kind_of(name) != INSTALLED:  # made by hand
                self.whole(name)
        elif spec.origin is not None and is_installed(spec.origin):
            if not unless_installed:
                self.installed(spec.name)
        elif isinstance(spec.origin, str) and not spec.origin.endswith(".py"):
            self.installed(spec.name)
        else:
            self.whole(spec.name)

    def installed(self, name: str) -> None:
        """A package by its version; a compiled module beside the user's own by its bytes."""
        top = name.split(".")[0]
        if top in sys.stdlib_module_names:
            return
        self._parts[f"package {top}"] = version_of(top)
        file = getattr(sys.modules.get(name), "__file__", None) or getattr(_spec(name), "origin", None)
        if isinstance(file, str) and os.path.isfile(file) and not file.endswith((".py", ".pyc")) \
                and not is_installed(file):
            self._parts[f"module {name}"] = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]

    def whole(self, name: str) -> None:
        """A module of the user's of which one cannot say what is used."""
        part = f"module {name}"
        if part in self._parts:
            return
        spec, loaded = _spec(name), sys.modules.get(name)
        origin = getattr(spec, "origin", None)
        if not isinstance(origin, str) or not origin.endswith(".py"):
            if isinstance(loaded, ModuleType) and not hasattr(loaded, "__path__"):
                self._parts[part] = ""
                self._set_in_module(name.rpartition(".")[2], vars(loaded), True)
            return
        there = os.stat(origin)
        found = _read(name, spec.parent or "", origin, there.st_mtime_ns, there.st_size)
        self._parts[part] = text_hash(found.content) + (" loaded before it was edited" if isinstance(
            loaded, ModuleType) and edited(loaded, found.given) else "")
        if isinstance(loaded, ModuleType):
            self._set_in_module(name.rpartition(".")[2], set_values(loaded, found.given), False)
        if "." in name:
            self.whole(name.rpartition(".")[0])
        for imported in found.imports:
            self.imported(imported, "")


@lru_cache(maxsize=256)
def _read(name: str, package: str, origin: str, *stamp: int) -> OwnText:
    return own_text(Path(origin).read_text(encoding="utf-8", errors="replace"), name, package)


def _spec(name: str) -> Any:
    try:
        return importlib.util.find_spec(name) if name and not name.startswith(".") else None
    except (ImportError, ValueError, AttributeError):
        return None
