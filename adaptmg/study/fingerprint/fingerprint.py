"""Fingerprint: what a run depends on, part by part.

Seen are: the code of the run function and of every function and class of the user's own modules that it can reach
(own: not installed, not adaptmg); defaults, variables of closures and globals that they read, by value; the modules of
adaptmg behind the names that they use, with all that those import (:mod:`adaptmg.study.fingerprint.package`); and the
versions of installed packages that they use. Not seen are data files, environment variables, and what is looked up by a
name made at run time (``getattr``, ``importlib``); ``depends=`` of the study names such things.
"""

from __future__ import annotations

import hashlib
import importlib.util
import platform
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from adaptmg.study.fingerprint import package
from adaptmg.study.fingerprint.instructions import code_text, free_read, globals_read, imports_in
from adaptmg.study.fingerprint.origin import (
    ADAPTMG,
    INSTALLED,
    OWN,
    PACKAGES,
    home_name,
    is_installed,
    kind_of,
    version_of,
)
from adaptmg.study.fingerprint.values import NoText, Texts

__all__ = ["Fingerprint", "environment", "fingerprint"]

_IMPORTS = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import|import[ \t]+([\w.]+))", re.MULTILINE)


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
        return _hash("\n".join(f"{name}\0{value}" for name, value in sorted(self.parts.items())), 64)

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
    walk = _Walk(depends or {})
    walk.from_function(function)
    return Fingerprint(walk.parts | package.reached(walk.roots))


def environment() -> dict[str, str]:
    """Versions of Python and of the packages the results depend on."""
    # not by way of the solvers, which take a second to load
    return {"python": platform.python_version(), **{name: version_of(name) for name in PACKAGES}}


def _hash(text: str, length: int = 16) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:length]


class _Walk:
    """Goes from a function to all it reads."""

    def __init__(self, depends: Mapping[str, Any]) -> None:
        self.parts: dict[str, str] = {}
        self.roots: set[str] = set()
        self._seen: set[int] = set()
        self._kept: list[Any] = []  # so that no number of `_seen` is used twice
        self._waiting: list[FunctionType | type] = []  # rather than by recursion, which has a limit
        self._depends = depends
        self._texts = Texts(self._refer)
        for name, value in depends.items():
            # a function is looked into
            content = value.read_bytes().hex() if isinstance(value, Path) else value
            self._part(f"depends {name}", self._texts.of(content))

    def _part(self, name: str, text: str) -> None:
        """Two things of one name (lambdas) count both."""
        self.parts[name] = _hash(self.parts.get(name, "") + text)

    # functions

    def from_function(self, function: FunctionType) -> None:
        """All parts, from the run function."""
        self._later(function)
        while self._waiting:
            thing = self._waiting.pop()
            if isinstance(thing, type):
                self._class(thing)
            else:
                self._function(thing)

    def _later(self, thing: FunctionType | type) -> None:
        if id(thing) not in self._seen:
            self._seen.add(id(thing))
            self._kept.append(thing)
            self._waiting.append(thing)

    def _function(self, function: FunctionType) -> None:
        """The code of a function, and all it reads."""
        name = _called(function)
        if kind_of(function.__module__) == ADAPTMG:
            self.roots.add(function.__module__)
        code = function.__code__
        self._part(f"function {name}", code_text(code))
        for what, value in (("defaults", function.__defaults__), ("keyword defaults", function.__kwdefaults__)):
            if value:
                self._value(f"{what} of {name}", "", value)
        taken = free_read(code)
        for variable, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                value = cell.cell_contents
            except ValueError:
                continue  # not set
            for attributes in dict.fromkeys(taken[variable]) or [()]:
                self._read(f"{variable} around {name}", variable, value, attributes)
        for variable, *attributes in globals_read(code):
            if variable in function.__globals__:
                value = function.__globals__[variable]
                self._read(f"{home_name(function)}.{variable}", variable, value, tuple(attributes))
        for imported in imports_in(code):
            self._import(imported, function.__globals__.get("__package__") or "")

    def _read(self, where: str, variable: str, value: Any, attributes: tuple[str, ...]) -> None:
        """A variable, and the attributes that are taken from it."""
        if variable in self._depends:
            return
        for attribute in attributes:
            if not isinstance(value, ModuleType) or kind_of(value.__name__) == INSTALLED:
                break
            if kind_of(value.__name__) == ADAPTMG and not hasattr(value, attribute):
                break
            if not hasattr(value, attribute):
                return  # the run will say so
            inner = getattr(value, attribute)
            if kind_of(value.__name__) == ADAPTMG and not isinstance(inner, ModuleType):
                home = getattr(inner, "__module__", None)
                self.roots.add(home if kind_of(home) == ADAPTMG and home else package.home_of(value.__name__,
                                                                                              attribute))
                return
            where, variable, value = f"{value.__name__.rpartition('.')[2]}.{attribute}", attribute, inner
            if variable in self._depends or where in self._depends:
                return
        self._value(f"value of {where}", where, value)

    def _value(self, part: str, variable: str, value: Any) -> None:
        if part in self._depends:
            return
        try:
            text = self._texts.of(value)
        except NoText as error:
            raise TypeError(f"the run function depends on the {part}, which cannot be told from another ({error}); "
                            f"build it in the function, give its ingredients with fixed={{...}}, or name what stands "
                            f"for it: depends={{{_variable(variable) or part!r}: ...}}") from error
        except RecursionError as error:
            raise TypeError(f"the run function depends on the {part}, which is nested too deeply to be compared") \
                from error
        # functions, classes and modules have parts of their own
        if not (isinstance(value, FunctionType | type | ModuleType)):
            self._part(part, text)

    # what stands for functions, classes and modules inside values

    def _refer(self, thing: Any) -> str:
        module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
        # classes that are sent to workers lose the name of what they stand in
        name = "" if isinstance(thing, ModuleType) else thing.__name__ if isinstance(thing, type) else \
            getattr(thing, "__qualname__", thing.__name__)
        kind = INSTALLED if module is None or module == "builtins" else kind_of(module)
        if kind == INSTALLED:
            top = (module or "builtins").split(".")[0]
            if top not in sys.stdlib_module_names:
                self.parts[f"package {top}"] = version_of(top)
        elif kind == ADAPTMG:
            self.roots.update(package.whole_package() if module == "adaptmg" else [module])
        elif isinstance(thing, ModuleType):
            self._whole(thing.__name__)
        elif isinstance(thing, FunctionType | type):
            self._later(thing)
        return f"{kind} {home_name(thing) if kind == OWN else module}.{name}"

    def _class(self, owner: type) -> None:
        name = f"{home_name(owner)}.{owner.__name__}"
        shown = {key: value for key, value in vars(owner).items()
                 if key not in ("__doc__", "__module__", "__dict__", "__weakref__", "__annotations__", "__qualname__",
                                "__firstlineno__", "__static_attributes__", "__slotnames__")
                 and type(value).__name__ not in ("member_descriptor", "getset_descriptor", "_abc_data")
                 and not ("__dataclass_fields__" in vars(owner) and _made_by_dataclass(value))}
        self._value(f"class {name}", name, list(owner.__bases__))
        for key, value in shown.items():
            self._value(f"{key} of class {name}", key, value)

    def _import(self, name: str, inside: str) -> None:
        """An import inside a function, or of a module that is used whole."""
        kind = kind_of(name.split(".")[0])
        if kind == ADAPTMG:
            module, _, last = name.rpartition(".")
            self._read(name, last, sys.modules.get(module) or importlib.import_module(module or name),
                       (last,) if module else ())
            return
        spec = next((found for full in (name, f"{inside}.{name}" if inside else "") if (found := _spec(full))), None)
        origin = getattr(spec, "origin", None)
        if spec is None or not isinstance(origin, str) or not origin.endswith(".py"):
            top = name.split(".")[0]
            if _spec(top) is not None and top not in sys.stdlib_module_names and kind_of(top) == INSTALLED:
                self.parts[f"package {top}"] = version_of(top)
        elif not is_installed(origin) and name.split(".")[0] not in sys.stdlib_module_names:
            self._whole(spec.name)
        elif name.split(".")[0] not in sys.stdlib_module_names:
            self.parts[f"package {name.split('.')[0]}"] = version_of(name.split(".")[0])

    def _whole(self, name: str) -> None:
        """A module of the user's of which one cannot say what is used: its text, and all it imports."""
        spec = _spec(name)
        origin = getattr(spec, "origin", None)
        if f"module {name}" in self.parts or not isinstance(origin, str) or not origin.endswith(".py"):
            return
        text = Path(origin).read_text(encoding="utf-8", errors="replace")
        try:
            content = code_text(compile(text, name, "exec", dont_inherit=True, optimize=2))
        except (SyntaxError, ValueError):
            content = text
        self.parts[f"module {name}"] = _hash(content)
        for match in _IMPORTS.finditer(text):
            self._import(match[1] or match[2], spec.parent or "")


def _variable(where: str) -> str:
    """Its bare name: ``LIMIT`` of ``script.LIMIT`` and of ``LIMIT around script.run``."""
    return where.split(" ")[0].rsplit(".", 1)[-1]


def _spec(name: str) -> Any:
    try:
        return importlib.util.find_spec(name) if name and not name.startswith(".") else None
    except (ImportError, ValueError, AttributeError):
        return None


def _made_by_dataclass(value: Any) -> bool:
    """A method that follows from the fields, which count."""
    file = value.__code__.co_filename if isinstance(value, FunctionType) else ""
    return file == "<string>" or Path(file).name in ("dataclasses.py", "reprlib.py")


def _called(function: FunctionType) -> str:
    return f"{home_name(function)}.{function.__qualname__}"
