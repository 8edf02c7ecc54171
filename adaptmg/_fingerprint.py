"""Fingerprint: what a run depends on, part by part.

All functions and classes of the user's own modules that the run function can reach are hashed, with the values that
they read: globals, variables of closures, defaults, attributes. Own modules are neither installed nor adaptmg. Of a
function the compiled code counts (a file may be edited after it is loaded), of a value its pickle. A module that is
imported inside a function, or used as a value, counts with all its names; adaptmg by one hash of its numerical sources,
installed packages by their version, compiled modules of the user by their content.

Not seen are data files, environment, time, working directory; the state of libraries and of Python; packages edited at
run time; plots and exports of adaptmg; modules imported under a name made at run time; docstrings and annotations; what
an object leaves out of its pickled state. ``depends=`` names such things.
"""

from __future__ import annotations

import contextlib
import ctypes
import dis
import functools
import hashlib
import importlib
import importlib.machinery
import importlib.metadata
import importlib.util
import io
import os
import pickle
import platform
import random
import sys
import sysconfig
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType

import numpy as np

#: on which the results of adaptmg depend, with itself
PACKAGES = ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")
_COMPILED = tuple(importlib.machinery.EXTENSION_SUFFIXES)
_MAIN = ("__main__", "__mp_main__")
_NOT_NUMERICAL = ("_fingerprint.py", "export", "plot", "study")
_RANDOM = (np.random.Generator, np.random.RandomState, np.random.BitGenerator, random.Random)
_NAMED = (FunctionType, type, ModuleType)
#: a function that reads these may read any global, or import by any text
_ANY_GLOBAL, _ANY_IMPORT = {"eval", "exec", "globals", "modules"}, {"__import__", "import_module", "modules"}
#: names of a module or class that do not count
_BOOKS = {"__abstractmethods__", "__annotate_func__", "__annotations__", "__builtins__", "__cached__", "__dict__",
          "__doc__", "__file__", "__firstlineno__", "__loader__", "__module__", "__name__", "__package__", "__path__",
          "__qualname__", "__slotnames__", "__spec__", "__static_attributes__", "__weakref__", "_value2member_map_"}
_DESCRIPTORS = ("_abc_data", "getset_descriptor", "member_descriptor")


@dataclass(frozen=True)
class Fingerprint:
    """Parts by name, each with a hash or a version."""

    parts: dict[str, str]

    @cached_property
    def code(self) -> str:
        """One hash of all parts."""
        text = "\n".join(f"{name}\0{value}" for name, value in sorted(self.parts.items()))
        return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

    @property
    def uses_adaptmg(self) -> bool:
        """Whether adaptmg is a part."""
        return "adaptmg" in self.parts

    def seen(self) -> Fingerprint:
        """Return the parts without ``depends``: the same in every process that computes the same."""
        return Fingerprint({name: value for name, value in self.parts.items() if not name.startswith("depends ")})

    def differences(self, other: Mapping[str, str]) -> list[str]:
        """Return the changes from the parts of another, as text."""
        both = {name: (self.parts.get(name), other.get(name)) for name in sorted({*self.parts, *other})}
        return [f"{name} {then} -> {now}" if name.startswith("package ") and now and then else
                f"{name} is {'new' if then is None else 'gone' if now is None else 'changed'}"
                for name, (now, then) in both.items() if now != then]


def fingerprint(function: Callable[..., object], depends: Mapping[str, object] | None = None) -> Fingerprint:
    """Return what a plain function depends on; TypeError for a value that it reads and that cannot be compared.
    ``depends`` has values by name, in place of globals and variables of closures, or for anything else; a
    :class:`pathlib.Path` stands for the content of the file."""
    if not isinstance(function, FunctionType):
        raise TypeError(f"run must be a plain function (def), got {function!r}; give constants with fixed={{...}}")
    references = _References(depends or {}, function.__globals__, "the run function depends on the",
                             "build it in the function, give its ingredients with fixed={...}, or ")
    references.name_of(function, follow=True)
    references.follow()
    return Fingerprint(references.parts | ({"adaptmg": _sources()} if references.uses_adaptmg else {}))


def value_parts(values: Mapping[str, object], depends: Mapping[str, object] | None = None) -> dict[str, str]:
    """Return parts for values by name, with the code in them; TypeError for a value that cannot be compared."""
    references = _References(depends or {}, vars(sys.modules["__main__"]), "what is stored depends on the", "")
    for name, value in values.items():
        references.value(name, value)
    references.follow()
    return references.parts


def environment() -> dict[str, str]:
    """Return the versions of Python and of the packages the results depend on."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


class _References:
    """Parts of all that is reached from a function or from values."""

    def __init__(self, depends: Mapping[str, object], main: Mapping[str, object], whose: str, remedy: str) -> None:
        self.parts: dict[str, str] = {}
        self.uses_adaptmg = False
        self._depends, self._whose, self._remedy = depends, whose, remedy
        # a script has one name, whether it is run, imported, or sent to a worker
        script = main.get("__name__") in _MAIN and main.get("__file__")
        self._main = Path(script).stem if script else "__main__"
        self._names: dict[int, str] = {}
        self._found: dict[str, list[object]] = {}
        self._waiting: list[tuple[str, object]] = []  # no recursion, which has a limit
        for name, value in depends.items():
            self.parts[f"depends {name}"] = self._hash(value.read_bytes() if isinstance(value, Path) else value)

    def follow(self) -> None:
        """Examine all functions, classes and modules that were found."""
        while self._waiting:
            name, thing = self._waiting.pop()
            if isinstance(thing, type):
                self.parts[f"class {name}"] = self._hash((thing.__bases__, type(thing)))
            (self._function if isinstance(thing, FunctionType) else self._all)(name, thing)

    def value(self, where: str, value: object) -> None:
        """Add a part; functions, classes and modules have parts under their own names."""
        bare = where.split(" ")[0].rpartition(".")[2]
        if {bare, where, f"value of {where}"}.intersection(self._depends) or (
                isinstance(value, _NAMED) and self.name_of(value) == f"own {where}"):
            return
        try:
            self.parts[f"value of {where}"] = self._hash(value)
        except Exception as error:  # whatever pickling raises
            raise TypeError(f"{self._whose} value of {where}, which cannot be compared ({error}); {self._remedy}name "
                            f"what stands for it: depends={{{bare!r}: ...}}") from error

    def name_of(self, thing: object, follow: bool = False) -> str:
        """Return what stands for a function, class or module in values; the user's own are followed later."""
        if id(thing) in self._names:
            return self._names[id(thing)]
        module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
        module = module if isinstance(module, str) else "builtins"
        # classes that are sent to workers lose the name of the function around them
        name = self._home(module) if isinstance(thing, ModuleType) else \
            f"{self._home(module)}.{thing.__name__ if isinstance(thing, type) else thing.__qualname__}"
        if not _is_own(module):
            self._package(module)
            if not follow:
                return f"installed {name}"
        # closures and classes of one name get numbers; the list keeps them alive, and so their id
        same = self._found.setdefault(name, [])
        same.append(thing)
        name = name if len(same) == 1 else f"{name} {len(same)}"
        self._names[id(thing)] = f"own {name}"
        self._waiting.append((name, thing))
        return f"own {name}"

    def _home(self, module: str) -> str:
        return self._main if module in _MAIN else module

    def _package(self, module: str) -> None:
        top = module.split(".")[0]
        self.uses_adaptmg |= top == "adaptmg"
        if top != "adaptmg" and top not in sys.stdlib_module_names:
            self.parts[f"package {top}"] = _version(top, getattr(_spec(module), "origin", None))

    def _hash(self, value: object) -> str:
        try:
            content = _pickled(value, self.name_of)
        except ValueError:  # an object that contains itself
            content = _pickled(value, self.name_of, fast=False)
        return hashlib.sha256(content).hexdigest()[:16]

    def _function(self, name: str, function: FunctionType) -> None:
        self.parts[f"function {name}"] = self._hash(function.__code__)
        own = {f"{what} of {name}": value for what in ("defaults", "kwdefaults")
               if (value := getattr(function, f"__{what}__"))}
        own |= {f"{name}.{attribute}": value for attribute, value in sorted(vars(function).items())}
        for where, value in own.items():
            self.value(where, value)
        cells, namespace = {}, function.__globals__
        for variable, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            with contextlib.suppress(ValueError):  # not set
                cells[variable] = cell.cell_contents
        home = self._home(namespace.get("__name__", "__main__"))
        names, imports = _reads(function.__code__)
        for first, *attributes in [*names, *((free,) for free in cells if all(free != chain[0] for chain in names))]:
            if first in cells:
                self._read(f"{first} around {name}", cells[first], attributes)
            elif first in namespace:
                self._read(f"{home}.{first}", namespace[first], attributes)
        if _ANY_GLOBAL.intersection(name for chain in names for name in chain):
            self._all(home, types.SimpleNamespace(**namespace))
        for imported in imports:
            self._import(imported, namespace.get("__package__") or "")

    def _read(self, where: str, value: object, attributes: list[str]) -> None:
        """Add a variable, or of a user's module the attribute that is taken from it."""
        for attribute in attributes:
            if not isinstance(value, ModuleType) or not _is_own(value.__name__) or attribute not in vars(value):
                break
            self.parts[f"value of {where}"] = self._hash(value.__name__)
            where, value = f"{self._home(value.__name__)}.{attribute}", vars(value)[attribute]
        self.value(where, value)

    def _all(self, name: str, owner: object) -> None:
        """Add all names of a module, which may hold values that cannot be compared, or of a class."""
        for key, value in sorted(vars(owner).items()):
            if key not in _BOOKS and type(value).__name__ not in _DESCRIPTORS:
                with contextlib.nullcontext() if isinstance(owner, type) else contextlib.suppress(TypeError):
                    self.value(f"{name}.{key}", value)

    def _import(self, name: str, package: str) -> None:
        """Follow a module that is imported inside a function; if relative, from a package around the function."""
        names = [name]
        while package:
            names.append(f"{package}.{name}")
            package = package.rpartition(".")[0]
        for full in names if name else ():
            if full in sys.modules or _spec(full):
                if not _is_own(full):
                    self._package(full)
                    continue
                with contextlib.suppress(Exception):  # the run will raise it
                    self.name_of(importlib.import_module(full))


#: what stands for objects that cannot be pickled, by their type
_STANDS: dict[type, Callable[..., object]] = {
    CodeType: lambda code: _plain_code(code), types.MappingProxyType: dict,
    **dict.fromkeys((staticmethod, classmethod), lambda value: (type(value).__name__, value.__func__)),
    property: lambda value: ("property", value.fget, value.fset, value.fdel),
    cached_property: lambda value: ("cached_property", value.func),  # holds a lock
    typing.TypeVar: lambda value: ("TypeVar", value.__name__),
    functools._lru_cache_wrapper: lambda value: ("lru_cache", value.__wrapped__, value.cache_parameters()["typed"]),
}


class _Pickler(pickle.Pickler):
    """Pickle for comparison: functions, classes and modules by name, some objects by their parts."""

    name_of: Callable[[object], str]

    def persistent_id(self, value: typing.Any) -> object:
        kind = type(value)
        if kind in (str, int, float, bool, type(None), bytes, list, dict, tuple):
            return None
        if isinstance(value, _NAMED):
            return self.name_of(value)
        if kind is BuiltinFunctionType and isinstance(value.__self__, ModuleType):
            return self.name_of(value.__self__), value.__name__
        if kind in (set, frozenset):
            return kind.__name__, sorted(_pickled(item, self.name_of) for item in value)
        if kind in _STANDS:
            return _STANDS[kind](value)
        if kind.__module__.startswith("numba."):
            inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
            if hasattr(value, "jit_methods"):
                return "jitclass", str(value.struct), value.jit_methods, value.jit_props, value.jit_static_methods
            if isinstance(inner, FunctionType):
                return "numba", inner, repr(sorted(getattr(value, "targetoptions", {}).items()))
        if isinstance(value, _RANDOM):
            raise pickle.PicklingError("a generator of random numbers, which runs would share and change: make one in "
                                       "the function, from a seed that is a parameter")
        if isinstance(value, ctypes.CDLL):
            raise pickle.PicklingError("a library of C")
        # cached properties follow from the rest
        caches = {name for owner in kind.__mro__ for name, part in vars(owner).items() if type(part) is cached_property}
        return (kind, {name: part for name, part in vars(value).items() if name not in caches}) if caches else None


def _pickled(value: object, name_of: Callable[[object], str], fast: bool = True) -> bytes:
    buffer = io.BytesIO()
    pickler = _Pickler(buffer, 5)
    # without references to what was pickled before, which depend on whether equal strings are one object
    pickler.fast, pickler.name_of = fast, name_of
    pickler.dump(value)
    return buffer.getvalue()


def _plain_code(code: CodeType) -> tuple[object, ...]:
    """Return a code object without file, lines and docstring."""
    constants = code.co_consts
    # Python 3.13 has a flag for docstrings; before, the first constant of every function that is defined is its own
    documented = code.co_flags & 0x4000000 if sys.version_info >= (3, 13) else \
        code.co_flags & 1 and not code.co_name.startswith("<")
    if documented and isinstance(constants[0], str):
        constants = (None, *constants[1:])
    return ("code", code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags & 0x2AC,
            code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_exceptiontable, constants)


def _reads(code: CodeType) -> tuple[list[tuple[str, ...]], list[str]]:
    """Return globals and variables of closures that are read, with attributes taken from them, and imports."""
    names: list[list[str]] = []
    imports: list[str] = []
    parts = [code]
    for part in parts:
        parts += [constant for constant in part.co_consts if isinstance(constant, CodeType)]
        chain, module = None, ""
        for step in dis.get_instructions(part):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS") \
                    or ("DEREF" in step.opname and step.argval in code.co_freevars):
                chain = [step.argval]
                names.append(chain)
            elif chain and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
                chain.append(step.argval)
            else:
                chain = None
            if step.opname == "IMPORT_NAME":
                module = step.argval
                imports.append(module)
            elif step.opname == "IMPORT_FROM":
                imports.append(f"{module}.{step.argval}" if module else step.argval)
    if any(_ANY_IMPORT.intersection(chain) for chain in names):
        imports += [text for part in parts for text in part.co_consts
                    if isinstance(text, str) and all(piece.isidentifier() for piece in text.split("."))]
    return list(dict.fromkeys(map(tuple, names))), imports


@cache
def _installed_places() -> tuple[str, ...]:
    places = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places |= {path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")}
    return tuple(os.path.realpath(place) + os.sep for place in places)


def _spec(name: str) -> importlib.machinery.ModuleSpec | None:
    try:
        return importlib.util.find_spec(name)
    except Exception:  # made by hand, or sent to a worker that lacks it; or its package cannot be imported
        return None


def _is_own(module: str) -> bool:
    """Whether a module is one of the user's, and not compiled."""
    if module.split(".")[0] in ("adaptmg", *sys.stdlib_module_names) and module not in _MAIN:
        return False
    spec = None if module in _MAIN else _spec(module)
    places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
    return not any(os.path.realpath(place).startswith(_installed_places()) or place.endswith(_COMPILED)
                   for place in places if isinstance(place, str))


@cache
def _version(package: str, file: str | None = None) -> str:
    """Return the version of an installed package, or the hash of a compiled module of the user."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16] if file and file.endswith(_COMPILED) else \
            str(getattr(sys.modules.get(package), "__version__", "unknown"))


@cache
def _sources() -> str:
    """Return one hash of adaptmg's numerical sources as this process first saw them."""
    root, content = Path(__file__).parent, hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        if file.relative_to(root).parts[0] not in _NOT_NUMERICAL:
            content.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return content.hexdigest()[:16]
