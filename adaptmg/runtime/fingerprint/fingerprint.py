"""Fingerprint: what a run depends on, part by part.

Seen are: the code of the run function and of every function and class of the user's own modules that it can reach
(own: not installed, not adaptmg); defaults, attributes of functions, variables of closures and globals that they read,
by value, and which function, class or module a name stands for; own modules that are imported inside a function, or
used as a value, by their whole text and the constants set in them; own compiled modules by their bytes; the modules of
adaptmg behind the names that are used, with all that those import (:mod:`adaptmg.runtime.fingerprint.package`); and the
versions of installed packages. Where ``eval``, ``exec`` or ``globals`` is called, all globals of that module count.

Not seen are: data files, environment variables, the time, the working directory; the state of libraries and of Python
(seeds of global generators, printing options, filters of warnings, contexts of ``decimal``, levels of loggers, classes
that are registered or derived elsewhere); code of an installed package that was edited or replaced at run time;
modules imported under a name made at run time; docstrings and annotations that are read; what an object leaves out of
the state it is pickled with. ``depends=`` of the study names such things.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import FunctionType
from typing import Any

from adaptmg.runtime.fingerprint import package
from adaptmg.runtime.fingerprint.origin import PACKAGES, version_of
from adaptmg.runtime.fingerprint.walk import Walk

__all__ = ["Fingerprint", "environment", "fingerprint", "value_parts"]


@dataclass(frozen=True)
class Fingerprint:
    """Parts by name, each with a hash or a version.

    Attributes
    ----------
    parts : dict of str to str
    """

    parts: dict[str, str]

    @cached_property
    def code(self) -> str:
        """One hash for all."""
        text = "\n".join(f"{name}\0{value}" for name, value in sorted(self.parts.items()))
        return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

    @property
    def uses_adaptmg(self) -> bool:
        """Whether a part of adaptmg is among them."""
        return any(name.startswith("adaptmg.") for name in self.parts)

    def seen(self) -> Fingerprint:
        """Without what ``depends`` names: the same in every process that computes the same."""
        return Fingerprint({name: value for name, value in self.parts.items() if not name.startswith("depends ")})

    def differences(self, other: Mapping[str, str]) -> list[str]:
        """What differs from the parts of another, in words."""
        told = []
        for name in sorted({*self.parts, *other}):
            now, then = self.parts.get(name), other.get(name)
            if now != then:
                version = name.startswith(("package ", "version "))
                told.append(f"{name} {then} -> {now}" if version and now and then else
                            f"{name} is {'new' if then is None else 'gone' if now is None else 'changed'}")
        return told


def fingerprint(function: Callable[..., Any], depends: Mapping[str, Any] | None = None) -> Fingerprint:
    """What ``function`` depends on.

    Parameters
    ----------
    function : function
        A plain function.
    depends : mapping, optional
        By name: values that stand for globals and variables of closures, which are then not looked at, or for anything
        else. A :class:`pathlib.Path` stands for the content of the file.

    Raises
    ------
    TypeError
        For other callables, and if a value that the function reads cannot be told from another.
    """
    if not isinstance(function, FunctionType):
        raise TypeError(f"run must be a plain function (def), got {function!r}; give constants with fixed={{...}}")
    walk = Walk(depends or {})
    walk.from_function(function)
    reached = package.reached(walk.roots)
    walk.from_values(package.replaced(reached))
    return Fingerprint(walk.parts | (package.reached(walk.roots) if walk.roots - set(reached) else reached))


def value_parts(values: Mapping[str, Any], depends: Mapping[str, Any] | None = None) -> dict[str, str]:
    """What the steps in a store depend on: values by name, with the code of the user's functions and classes in them.

    Raises
    ------
    TypeError
        If a value cannot be told from another, and is not named by ``depends``, as of :func:`fingerprint`.
    """
    walk = Walk(depends or {}, "what is stored depends on the", "")
    walk.from_values(values)
    return walk.parts


def environment() -> dict[str, str]:
    """Versions of Python and of the packages the results depend on."""
    # not by way of the solvers, which take a second to load
    return {"python": platform.python_version(), **{name: version_of(name) for name in PACKAGES}}
