"""Fingerprint: what a run depends on, part by part.

From the run function on, functions and classes of the user's modules are followed by what they read: globals, variables
of closures, defaults, attributes, imports. Of a function the compiled code counts (a file may be edited after it is
loaded), of a value its pickle, of a module that is imported inside a function or used as a value all names. adaptmg
counts by one hash of its numerical sources, an installed package by its version, the user's compiled modules by their
content. :class:`adaptmg.study.Study` lists what is not seen.
"""

from __future__ import annotations

import contextlib
import ctypes
import dis
import enum
import functools
import hashlib
import importlib
import importlib.machinery
import importlib.metadata
import importlib.util
import io
import itertools
import pickle
import platform
import random
import sys
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MappingProxyType, ModuleType

import numpy as np

#: on which the results of adaptmg depend, with itself
PACKAGES = ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")
_NOT_NUMERICAL = ("_fingerprint.py", "export", "plot", "study")
_COMPILED = tuple(importlib.machinery.EXTENSION_SUFFIXES)
_MAIN = ("__main__", "__mp_main__")
_NAMED = (FunctionType, type, ModuleType)
#: what runs would share and change, or what only an address stands for
_REFUSED = (np.random.Generator, np.random.RandomState, np.random.BitGenerator, random.Random, ctypes.CDLL)
#: a function that reads one of these may read any global, or import a module that is named in a text
_ANY = {"eval", "exec", "globals", "modules", "__import__", "import_module"}
_GLOBAL, _ATTRIBUTE = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"), ("LOAD_ATTR", "LOAD_METHOD")
#: names of a module or class that do not count
_BOOKS = {"__abstractmethods__", "__annotate_func__", "__annotations__", "__builtins__", "__cached__", "__dict__",
          "__doc__", "__file__", "__firstlineno__", "__loader__", "__module__", "__name__", "__package__", "__path__",
          "__qualname__", "__slotnames__", "__spec__", "__static_attributes__", "__weakref__", "_value2member_map_"}


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
    found = _Parts(depends or {}, function.__globals__)
    found.name_of(function, follow=True)
    return Fingerprint(found.complete())


def value_parts(values: Mapping[str, object], depends: Mapping[str, object] | None = None) -> dict[str, str]:
    """Return parts for values by name, with the code in them; TypeError for a value that cannot be compared."""
    found = _Parts(depends or {}, vars(sys.modules["__main__"]))
    for name, value in values.items():
        found.value(name, value)
    return {name: part for name, part in found.complete().items() if name != "adaptmg"}


def environment() -> dict[str, str]:
    """Return the versions of Python and of the packages the results depend on."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


class _Parts:
    """Parts of all that is reached from a function or from values."""

    def __init__(self, depends: Mapping[str, object], main: Mapping[str, object]) -> None:
        self._depends = depends
        # a script has one name, whether it is run, imported, or sent to a worker
        script = main.get("__name__") in _MAIN and main.get("__file__")
        self._main = Path(script).stem if script else "__main__"
        self._names: dict[int, str] = {}
        self._found: dict[str, list[object]] = {}
        self._waiting: list[tuple[str, object]] = []  # no recursion, which has a limit
        self._parts = {f"depends {name}": self._hash(value.read_bytes() if isinstance(value, Path) else value)
                       for name, value in depends.items()}

    def complete(self) -> dict[str, str]:
        """Examine all functions, classes and modules that were found, and return the parts."""
        while self._waiting:
            name, thing = self._waiting.pop()
            if isinstance(thing, FunctionType):
                self._function(name, thing)
                continue
            if isinstance(thing, type):
                self._parts[f"class {name}"] = self._hash((thing.__bases__, type(thing)))
            self._all(name, vars(thing), strict=isinstance(thing, type))
        return self._parts

    def value(self, where: str, value: object) -> None:
        """Add a part; functions, classes and modules have parts under their own names."""
        bare = where.split(" ")[0].rpartition(".")[2]
        if {bare, where, f"value of {where}"}.intersection(self._depends) or (
                isinstance(value, _NAMED) and self.name_of(value) == f"own {where}"):
            return
        try:
            self._parts[f"value of {where}"] = self._hash(value)
        except Exception as error:  # whatever pickling raises
            raise TypeError(f"results depend on the value of {where}, which cannot be compared ({error}): build it "
                            f"where it is used, or name what stands for it: depends={{{bare!r}: ...}}") from error

    def name_of(self, thing: object, follow: bool = False) -> str:
        """Return what stands for a function, class or module in values; the user's are followed later."""
        if id(thing) in self._names:
            return self._names[id(thing)]
        module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
        module = module if isinstance(module, str) else "builtins"
        # classes that are sent to workers lose the name of the function around them
        name = self._home(module) if isinstance(thing, ModuleType) else \
            f"{self._home(module)}.{thing.__name__ if isinstance(thing, type) else thing.__qualname__}"
        if not self._is_own(module) and not follow:
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

    def _is_own(self, module: str) -> bool:
        """Whether a module is one of the user's, and not compiled; of others the version or content becomes a part."""
        top, spec = module.split(".")[0], None if module in _MAIN else _spec(module)
        if top == "adaptmg":
            self._parts[top] = _sources()
        elif module in _MAIN or top not in sys.stdlib_module_names:
            places = [spec.origin or "", *(spec.submodule_search_locations or ())] if spec else []
            if not any({"site-packages", "dist-packages"} & set(Path(place).parts) or place.endswith(_COMPILED)
                       for place in places):
                return True
            self._parts[f"package {top}"] = _version(top, places[0])
        return False

    def _hash(self, value: object) -> str:
        try:
            content = _pickled(value, self.name_of)
        except ValueError:  # an object that contains itself
            content = _pickled(value, self.name_of, fast=False)
        return hashlib.sha256(content).hexdigest()[:16]

    def _function(self, name: str, function: FunctionType) -> None:
        code, namespace, cells = function.__code__, function.__globals__, {}
        self._parts[f"function {name}"] = self._hash(code)
        for key in ("__defaults__", "__kwdefaults__", *vars(function)):
            if (value := getattr(function, key)) is not None:
                self.value(f"{name}.{key}", value)
        for variable, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            with contextlib.suppress(ValueError):  # not set
                cells[variable] = cell.cell_contents
        home = self._home(namespace.get("__name__", "__main__"))
        names, imports = _reads(code, namespace.get("__package__") or "")
        for first, *attributes in names:
            if first in cells:
                self._read(f"{first} around {name}", cells[first], attributes)
            elif first in namespace:
                self._read(f"{home}.{first}", namespace[first], attributes)
            if _ANY.intersection((first, *attributes)):
                self._all(home, namespace, strict=False)
        for module in imports:
            if (module in sys.modules or _spec(module)) and self._is_own(module):
                with contextlib.suppress(Exception):  # the run will raise it
                    self.name_of(importlib.import_module(module))

    def _read(self, where: str, value: object, attributes: Sequence[str]) -> None:
        """Add a variable, or of a user's module the attribute that is taken from it."""
        for attribute in attributes:
            if not isinstance(value, ModuleType) or not self._is_own(value.__name__) or attribute not in vars(value):
                break
            self._parts[f"value of {where}"] = self._hash(value.__name__)
            where, value = f"{self._home(value.__name__)}.{attribute}", vars(value)[attribute]
        self.value(where, value)

    def _all(self, name: str, values: Mapping[str, object], strict: bool) -> None:
        """Add all names of a class, or of a module, which may hold values that cannot be compared."""
        for key, value in sorted(values.items()):
            if key not in _BOOKS and not type(value).__name__.endswith(("_descriptor", "_abc_data")):
                with contextlib.suppress(*() if strict else (TypeError,)):
                    self.value(f"{name}.{key}", value)


#: objects that cannot be pickled: attributes that stand for them
_STANDS: dict[type, tuple[str, ...]] = {
    staticmethod: ("__func__",), classmethod: ("__func__",), property: ("fget", "fset", "fdel"),
    cached_property: ("func",), typing.TypeVar: ("__name__",), functools._lru_cache_wrapper: ("__wrapped__",)}


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
        if kind in (CodeType, MappingProxyType):
            return _plain_code(value) if kind is CodeType else dict(value)
        if kind in _STANDS:
            return kind.__name__, [getattr(value, name) for name in _STANDS[kind]]
        if kind.__module__.startswith("numba."):
            inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
            if hasattr(value, "jit_methods"):
                return "jitclass", str(value.struct), value.jit_methods, value.jit_props, value.jit_static_methods
            if isinstance(inner, FunctionType):
                return "numba", inner, repr(sorted(getattr(value, "targetoptions", {}).items()))
        if isinstance(value, _REFUSED):
            raise pickle.PicklingError("runs share its state, or it has an address alone; random numbers come from a "
                                       "seed that is a parameter")
        if isinstance(value, enum.Enum):  # early releases of Python 3.11 pickle the name alone
            return kind, value._name_, value._value_
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


def _reads(code: CodeType, package: str) -> tuple[list[tuple[str, ...]], list[str]]:
    """Return globals and variables of closures that are read, with attributes taken from them, and modules that are
    imported from a function in a package."""
    names: list[tuple[str, ...]] = []
    imports: list[str] = []
    parts = [code]
    for part in parts:
        parts += [constant for constant in part.co_consts if isinstance(constant, CodeType)]
        steps = [step for step in dis.get_instructions(part) if step.opname != "EXTENDED_ARG"]
        for place, step in enumerate(steps):
            if step.opname in _GLOBAL or ("DEREF" in step.opname and step.argval in code.co_freevars):
                after = itertools.takewhile(lambda one: one.opname in _ATTRIBUTE, steps[place + 1:place + 9])
                names.append((step.argval, *(one.argval for one in after)))
            elif step.opname == "IMPORT_NAME":
                level, listed = (before.argval for before in steps[place - 2:place])
                with contextlib.suppress(ImportError):  # the run will raise it
                    module = importlib.util.resolve_name("." * level + step.argval, package)
                    imports += [module, *(f"{module}.{name}" for name in listed or ())]
    if any(_ANY.intersection(chain) for chain in names):
        imports += [text for part in parts for text in part.co_consts
                    if isinstance(text, str) and all(piece.isidentifier() for piece in text.split("."))]
    return list(dict.fromkeys(names)), imports


def _spec(name: str) -> importlib.machinery.ModuleSpec | None:
    try:
        return importlib.util.find_spec(name)
    except Exception:  # made by hand, or sent to a worker that lacks it; or its package cannot be imported
        return None


@cache
def _version(package: str, file: str = "") -> str:
    """Return the version of an installed package, or the hash of a compiled module of the user."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16] if file.endswith(_COMPILED) else \
            str(getattr(sys.modules.get(package), "__version__", "unknown"))


@cache
def _sources() -> str:
    """Return one hash of adaptmg's numerical sources as this process first saw them."""
    root, content = Path(__file__).parent, hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        if file.relative_to(root).parts[0] not in _NOT_NUMERICAL:
            content.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return content.hexdigest()[:16]
