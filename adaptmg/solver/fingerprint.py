"""Fingerprint: what a run depends on, part by part.

From the run function on, functions and classes of the user's modules are followed by what they
read: globals, variables of closures, defaults, attributes, imports. Of a function the instructions
count, those that run and not those of a file that was edited since; they contain neither
docstrings, comments nor lines. Of a value its pickle counts, of an instance of a user's class all
that it holds. adaptmg counts by one hash of its numerical sources, an installed package by its
version. What cannot be compared is refused; :class:`adaptmg.study.Study` lists what is not seen.
"""

from __future__ import annotations

import contextlib
import ctypes
import dis
import functools
import hashlib
import importlib
import importlib.metadata
import importlib.util
import io
import itertools
import pickle
import platform
import random
import sys
import sysconfig
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, cached_property
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    MappingProxyType,
    MemberDescriptorType,
    ModuleType,
    WrapperDescriptorType,
)

import numpy as np
from scipy import sparse

#: packages on which results depend, adaptmg included
PACKAGES = ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")
_NOT_NUMERICAL = ("cli", "export", "plot", "study")
_MAIN = ("__main__", "__mp_main__")
#: kinds of objects that are followed by name
_NAMED = (FunctionType, type, ModuleType)
#: kinds of objects whose state runs would share and change, or that are only an address
_REFUSED = (
    np.random.Generator,
    np.random.RandomState,
    np.random.BitGenerator,
    random.Random,
    ctypes.CDLL,
)
#: names that hide what results depend on: through them a function may read any object (``eval``, ``sys.modules``),
#: or attributes that the comparison leaves out (``__doc__``). A function that reads one is refused
_HIDDEN = {
    "eval",
    "exec",
    "globals",
    "__import__",
    "import_module",
    "modules",
    "__annotations__",
    "__doc__",
    "__subclasses__",
}
#: instructions that read a global, or an attribute
_GLOBAL = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")
_ATTRIBUTE = ("LOAD_ATTR", "LOAD_METHOD")
#: names in a class or module that Python sets, and that do not count
_BOOKKEEPING = {
    "__abstractmethods__",
    "__annotate_func__",
    "__annotations__",
    "__builtins__",
    "__cached__",
    "__dict__",
    "__doc__",
    "__file__",
    "__firstlineno__",
    "__loader__",
    "__module__",
    "__name__",
    "__package__",
    "__path__",
    "__qualname__",
    "__slotnames__",
    "__spec__",
    "__static_attributes__",
    "__weakref__",
    "_abc_impl",
    "_value2member_map_",
}
#: kinds of objects that cannot be pickled, with the attributes that are compared in their place
_COMPARED_BY: dict[type, tuple[str, ...]] = {
    staticmethod: ("__func__",),
    classmethod: ("__func__",),
    property: ("fget", "fset", "fdel"),
    cached_property: ("func",),
    typing.TypeVar: ("__name__",),
    functools._lru_cache_wrapper: ("__wrapped__",),
    MemberDescriptorType: ("__name__",),
}
#: the generator of numpy's functions and, unless it is given another, of scipy's distributions
_NUMPY_GENERATOR = np.random.rand.__self__
_BASES: tuple[type[typing.Any], ...] = (
    dict,
    list,
    tuple,
    set,
    frozenset,
    str,
    bytes,
    bytearray,
    int,
    float,
    complex,
)


#: kinds of objects that are pickled unchanged; what containers hold is examined in turn
_PICKLED = (dict, list, tuple, str, int, float, bool, type(None), bytes)


@dataclass(frozen=True)
class Fingerprint:
    """The parts that a run depends on, by name, each with a hash or a version."""

    parts: dict[str, str]

    @cached_property
    def code(self) -> str:
        """Return one hash of all parts."""
        text = "\n".join(f"{name}\0{value}" for name, value in sorted(self.parts.items()))
        return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

    def seen(self) -> Fingerprint:
        """Return the parts except those of ``depends``: they agree in all processes that run the same
        code."""
        return Fingerprint(
            {name: value for name, value in self.parts.items() if not name.startswith("depends ")}
        )

    def differences(self, other: Mapping[str, str]) -> list[str]:
        """Return the changes from other parts to these, as text."""
        both = {
            name: (self.parts.get(name), other.get(name)) for name in sorted({*self.parts, *other})
        }
        return [
            f"{name} {then} -> {now}"
            if name.startswith("package ") and now and then
            else f"{name} is {'new' if then is None else 'gone' if now is None else 'changed'}"
            for name, (now, then) in both.items()
            if now != then
        ]


def fingerprint(
    function: Callable[..., object], depends: Mapping[str, object] | None = None
) -> Fingerprint:
    """Return the parts that a plain function depends on; TypeError if it reads a value that cannot be
    compared. ``depends`` has values by name that are compared in place of globals and variables of
    closures, or in addition; a :class:`pathlib.Path` in it stands for the content of the file."""
    if not isinstance(function, FunctionType):
        raise TypeError(
            f"run must be a plain function (def), got {function!r}; give constants with fixed={{...}}"
        )
    found = _Parts(depends or {}, function.__globals__)
    # it is among those that complete() examines, even if it is installed
    found.name_of(function, follow=True)
    return Fingerprint(found.complete())


def value_parts(
    values: Mapping[str, object], depends: Mapping[str, object] | None = None
) -> dict[str, str]:
    """Return parts for values by name, with the code in them; TypeError for a value that cannot be
    compared."""
    found = _Parts(depends or {}, vars(sys.modules["__main__"]))
    for name, value in values.items():
        found.add_value(name, value)
    return {name: part for name, part in found.complete().items() if name != "adaptmg"}


def environment() -> dict[str, str]:
    """Return the versions of Python and of the packages the results depend on."""
    return {
        "python": platform.python_version(),
        **{name: _version(name) or "unknown" for name in PACKAGES},
    }


class _Parts:
    """Collects the parts of all objects that can be reached from a function or from values."""

    def __init__(self, depends: Mapping[str, object], main: Mapping[str, object]) -> None:
        """Begin with the values that ``depends`` names; ``main`` has the globals of the script."""
        self._depends = depends
        # a script has one name, whether it is run, imported, or sent to a worker
        script = main.get("__file__") if main.get("__name__") in _MAIN else None
        self._main = Path(script).stem if isinstance(script, str) else "__main__"
        self._names: dict[int, str] = {}  # by id, as name_of returns them
        self._found: dict[str, list[object]] = {}  # by name, those of the user and followed ones
        # functions, classes and modules still to be examined: a list, since recursion has a limit
        self._waiting: list[tuple[str, object]] = []
        self._parts = {
            f"depends {name}": self._hash(value, files=True) for name, value in depends.items()
        }

    def complete(self) -> dict[str, str]:
        """Examine all functions, classes and modules that were found, and return the parts."""
        while self._waiting:
            name, thing = self._waiting.pop()
            if isinstance(thing, FunctionType):
                self._add_function(name, thing)
                continue
            if isinstance(thing, type):
                self._parts[f"class {name}"] = self._hash((thing.__bases__, type(thing)))
            for key, value in sorted(vars(thing).items()):
                if key not in _BOOKKEEPING:
                    self.add_value(f"{name}.{key}", value)
        return self._parts

    def add_value(self, where: str, value: object) -> None:
        """Add the part of a value that is read at ``where``, unless ``depends`` names it. Functions,
        classes and modules have parts under their own names."""
        # ``depends`` may contain its name, without its module before a dot and the words after a
        # space; ``where``; or the name of its part in a stored fingerprint
        bare = where.split(" ")[0].rpartition(".")[2]
        if {bare, where, f"value of {where}"}.intersection(self._depends):
            return
        if isinstance(value, _NAMED):
            name = self.name_of(value)  # now it is examined later, if it is the user's
            if name == f"own {where}":  # it is read where it is defined: its parts suffice
                return
        try:
            self._parts[f"value of {where}"] = self._hash(value)
        except Exception as error:  # whatever pickling raises
            raise TypeError(
                f"results depend on the value of {where}, which cannot be compared ({error}): build it "
                f"where it is used, or name what stands for it: depends={{{bare!r}: ...}}"
            ) from error

    def name_of(self, thing: object, follow: bool = False) -> str:
        """Return the text that represents a function, class or module in values; those of the user,
        and with ``follow`` installed ones, are examined later."""
        if id(thing) in self._names:
            return self._names[id(thing)]
        module = _module_of(thing)
        name = self._home(module)
        if not isinstance(thing, ModuleType):
            # of classes without the function around them, whose name is lost where they are sent to workers
            qualified = getattr(thing, "__name__" if isinstance(thing, type) else "__qualname__")
            name = f"{name}.{qualified}"
        if not self.is_own(module, thing) and not follow:
            return f"installed {name}"
        # closures and classes of the same name get numbers; the list keeps them, and so their id
        same = self._found.setdefault(name, [])
        same.append(thing)
        name = name if len(same) == 1 else f"{name} {len(same)}"
        self._names[id(thing)] = f"own {name}"
        self._waiting.append((name, thing))
        return f"own {name}"

    def _home(self, module: str) -> str:
        """Return the name of a module, of the script that of its file."""
        return self._main if module in _MAIN else module

    def is_own(self, module: str, thing: object = None) -> bool:
        """Return whether a module belongs to the user and ``thing``, a function or class in it, if it is given,
        is not compiled. Of any other module the text that compares it (:func:`_installed`), unless this is
        empty, becomes a part."""
        if version := _installed(module):
            top = module.split(".")[0]
            self._parts[top if top == "adaptmg" else f"package {top}"] = version
        return version is None and not _is_compiled(thing)

    def _hash(self, value: object, files: bool = False) -> str:
        """Return a hash of a value; ``files`` as of :func:`_pickled`."""
        return hashlib.sha256(_pickled(value, self, files)).hexdigest()[:16]

    def _add_function(self, name: str, function: FunctionType) -> None:
        """Add the parts of a function: its instructions, its defaults, and all that it reads."""
        code = function.__code__
        self._parts[f"function {name}"] = self._hash(code)
        for key in ("__defaults__", "__kwdefaults__", *vars(function)):
            if (value := getattr(function, key)) is not None:
                self.add_value(f"{name}.{key}", value)
        chains, imports = _reads(code)
        self._add_chains(name, function, chains)
        package = function.__globals__.get("__package__") or ""
        for level, module, names in imports:
            with contextlib.suppress(ImportError):  # the run will raise it
                self._add_import(importlib.util.resolve_name("." * level + module, package), names)

    def _add_chains(self, name: str, function: FunctionType, chains: list[tuple[str, ...]]) -> None:
        """Add the globals and the variables of enclosing functions that a function reads, each first in
        a chain with the attributes that are taken from it: ("np", "linalg", "norm"). TypeError if a
        chain holds a hidden name. In chains of attributes alone the first name is empty."""
        namespace = function.__globals__
        home = self._home(namespace.get("__name__", "__main__"))
        enclosing: dict[str, object] = {}
        for variable, cell in zip(
            function.__code__.co_freevars, function.__closure__ or (), strict=True
        ):
            with contextlib.suppress(ValueError):  # not set
                enclosing[variable] = cell.cell_contents
        for first, *attributes in chains:
            # a variable of the user may have one of the hidden names
            is_own = first in enclosing or first in namespace
            names = attributes if is_own else (first, *attributes)
            hidden = _HIDDEN.intersection(names) - set(self._depends)
            if hidden:
                raise TypeError(
                    f"{name} reads {min(hidden)}, so that it cannot be seen what results depend on: name "
                    f"what stands for it: depends={{{min(hidden)!r}: ...}}"
                )
            if first in enclosing:
                self._add_variable(f"{first} around {name}", enclosing[first], attributes)
            elif first in namespace:  # what is left are functions of Python, as ``len``
                self._add_variable(f"{home}.{first}", namespace[first], attributes)

    def _add_import(self, module: str, names: tuple[str, ...] | None) -> None:
        """Add what a function imports while it runs, if the module is the user's: the ``names`` from it,
        or, without names, the module and the packages around it, which ``import a.b.c`` loads, too."""
        if not self.is_own(module):
            return
        imported = importlib.import_module(module)
        for item in names or ():
            if not hasattr(imported, item):
                importlib.import_module(f"{module}.{item}")
            self._add_variable(self._home(module), imported, [item])
        if not names:
            for part in itertools.accumulate(module.split("."), "{}.{}".format):
                self.add_value(self._home(part), sys.modules[part])

    def _add_variable(self, where: str, value: object, attributes: Sequence[str]) -> None:
        """Add a variable, or of a user's module the attribute that is taken from it."""
        for attribute in attributes:
            if (
                not isinstance(value, ModuleType)
                or not self.is_own(value.__name__)
                or attribute not in vars(value)
            ):
                break
            self._parts[f"value of {where}"] = self._hash(value.__name__)
            where = f"{self._home(value.__name__)}.{attribute}"
            value = vars(value)[attribute]
        self.add_value(where, value)


class _Pickler(pickle.Pickler):
    """A pickler for comparison: functions, classes and modules are written by name, objects that
    cannot be compared by their pickle by their contents."""

    found: _Parts
    files: bool  # whether paths stand for files
    # by id: the number of an instance, and the instance, which is kept alive
    instances: dict[int, tuple[int, object]]

    def persistent_id(self, value: typing.Any) -> object:
        """Return the value that replaces an object in the pickle; None: the object is pickled."""
        if type(value) in _PICKLED:
            return None
        if isinstance(value, _NAMED):
            return self.found.name_of(value)
        if type(value) is BuiltinFunctionType and isinstance(value.__self__, ModuleType):
            return self.found.name_of(value.__self__), value.__name__
        comparable = self._comparable(value)
        return self._instance(value) if comparable is None else comparable

    def _comparable(self, value: typing.Any) -> object:
        """Return what an object without a pickle is compared by, or one whose pickle may change though
        the object does not; PicklingError if it cannot be compared, None for other objects. An object
        is of one of these kinds at most."""
        kind = type(value)
        # builtin objects: the pickle of a set depends on the order of a hash
        if kind in (set, frozenset):
            return kind.__name__, sorted(_pickled(item, self.found, self.files) for item in value)
        if kind is CodeType:
            return _plain_code(value)
        if kind is MappingProxyType:
            return dict(value)
        if kind in _COMPARED_BY:
            return kind.__name__, [getattr(value, name) for name in _COMPARED_BY[kind]]
        # what numba compiles: its source
        if _module_of(kind).startswith("numba."):
            if hasattr(value, "jit_methods"):  # of a jitclass
                parts = value.jit_methods, value.jit_props, value.jit_static_methods
                return str(value.struct), *parts
            inner = getattr(value, "py_func", getattr(value, "__wrapped__", None))
            if isinstance(inner, FunctionType):
                return "numba", inner, repr(sorted(getattr(value, "targetoptions", {}).items()))
        # objects with a state outside of the run
        if value is _NUMPY_GENERATOR:  # its state belongs to the library
            return "numpy.random"
        if isinstance(value, _REFUSED) or isinstance(getattr(value, "__self__", None), _REFUSED):
            raise pickle.PicklingError(
                "runs share its state, or it has an address alone; random numbers come from a "
                "seed that is a parameter"
            )
        if self.files and isinstance(value, Path):
            return "file", _content(value)
        if (_module_of(kind), kind.__name__) == ("netgen.libngpy._meshing", "Mesh"):
            raise pickle.PicklingError(
                "the pickle of a mesh of Netgen differs in each process, that of am.mesh.as_mesh(mesh) does not"
            )
        if sparse.issparse(value):
            # scipy notes there whether the indices are sorted, when it is asked
            noted = ("_has_sorted_indices", "_has_canonical_format")
            return kind, {name: part for name, part in vars(value).items() if name not in noted}
        return None

    def _instance(self, value: typing.Any) -> object:
        """Return the contents of an instance of a user's class, or of a class with measured seconds or
        cached properties whose pickle holds all attributes; None for other objects."""
        kind = type(value)
        leaves_out = bool(_measured(kind)) or any(
            type(part) is cached_property for owner in kind.__mro__ for part in vars(owner).values()
        )
        by_default = (kind.__reduce__, kind.__getstate__) == (
            object.__reduce__,
            object.__getstate__,
        )
        pickles_all = leaves_out and by_default
        if not self.found.is_own(_module_of(kind), kind) and not pickles_all:
            return None
        if id(value) in self.instances:
            return "again", self.instances[id(value)][0]
        self.instances[id(value)] = len(self.instances), value
        return _contents(value, self.found)


def _module_of(thing: object) -> str:
    """Return the name of a module, or of the module of a function or class. Some of these have no text
    there: they count as builtins."""
    name = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
    return name if isinstance(name, str) else "builtins"


def _measured(kind: type) -> set[str]:
    """Return the fields of a class of adaptmg that hold measured seconds, which differ in each
    process."""
    if not (kind.__module__.startswith("adaptmg.") and is_dataclass(kind)):
        return set()
    return {item.name for item in fields(kind) if not item.compare}


def _contents(value: typing.Any, found: _Parts) -> tuple[object, ...]:
    """Return the class of an instance and all that it holds, except measured seconds and cached
    properties, which follow from the rest: its own pickle may leave out more.

    Next to slots and attributes these are the contents of a base class: for a subclass of an array
    its numbers, by the ``__reduce__`` of the array; for a subclass of dict its items, as a dict."""
    kind = type(value)
    class_attributes = {
        name: part for owner in reversed(kind.__mro__) for name, part in vars(owner).items()
    }
    measured = _measured(kind)
    slots = {
        name: getattr(value, name)
        for name, part in class_attributes.items()
        if type(part) is MemberDescriptorType and hasattr(value, name)
    }
    attributes = slots | {
        name: item
        for name, item in getattr(value, "__dict__", {}).items()
        if type(class_attributes.get(name)) is not cached_property and name not in measured
    }
    for base in kind.__mro__[:-1]:  # the last one is object, whose __reduce__ holds no more
        if "__reduce__" in vars(base) and not found.is_own(base.__module__):
            return kind, attributes, vars(base)["__reduce__"](value)
    plain = next((base(value) for base in _BASES if isinstance(value, base)), None)
    return kind, attributes, plain


def _pickled(value: object, found: _Parts, files: bool = False) -> bytes:
    """Return the bytes by which a value is compared; with ``files`` a path is compared by the content
    of its file."""
    buffer = io.BytesIO()
    pickler = _Pickler(buffer, 5)
    # no references to earlier objects, which depend on whether equal strings are the same object;
    # lists and dictionaries that contain themselves are refused
    pickler.fast = True
    pickler.found = found
    pickler.files = files
    pickler.instances = {}
    pickler.dump(value)
    return buffer.getvalue()


def _plain_code(code: CodeType) -> tuple[object, ...]:
    """Return the parts of a code object that count: not the file, lines and docstrings. (No instruction
    of a function reads its docstring, and a class stores it under a name that is left out.)"""
    steps = [(step.opname, step.argval) for step in dis.get_instructions(code)]
    # a class stores its docstring, its module and so on by two instructions, of which neither counts
    counted = [
        step
        for step, after in zip(steps, [*steps[1:], ("", None)], strict=True)
        if not any(name == "STORE_NAME" and value in _BOOKKEEPING for name, value in (step, after))
    ]
    return (
        "code",
        code.co_argcount,
        code.co_posonlyargcount,
        code.co_kwonlyargcount,
        code.co_flags & 0x2AC,  # *args, **kwargs; generator, coroutine, asynchronous generator
        code.co_varnames,
        code.co_freevars,
        code.co_exceptiontable,
        counted,
    )


def _reads(
    code: CodeType,
) -> tuple[list[tuple[str, ...]], list[tuple[int, str, tuple[str, ...] | None]]]:
    """Return the globals and variables of closures that code reads, each with the attributes taken
    from it, and its imports (level, module, names). A hidden name that is read as an attribute of
    whatever value, as of an argument, also comes after an empty first name, since most have no name."""
    chains = []
    imports = []
    # the code itself and, as the list grows, all functions inside it. Only variables of closures that
    # come from around the outermost function count
    parts = [code]
    for part in parts:
        parts += [constant for constant in part.co_consts if isinstance(constant, CodeType)]
        steps = [step for step in dis.get_instructions(part) if step.opname != "EXTENDED_ARG"]
        for place, step in enumerate(steps):
            if step.opname in _GLOBAL or (
                "DEREF" in step.opname and step.argval in code.co_freevars
            ):
                after = itertools.takewhile(
                    lambda step_after: step_after.opname in _ATTRIBUTE, steps[place + 1 :]
                )
                chains.append((step.argval, *(step_after.argval for step_after in after)))
            elif step.opname in _ATTRIBUTE and step.argval in _HIDDEN:
                chains.append(("", step.argval))
            elif step.opname == "IMPORT_NAME":  # level and names are loaded just before it
                level, names = (before.argval for before in steps[place - 2 : place])
                imports.append((level, step.argval, names))
    return list(dict.fromkeys(chains)), imports


def _is_compiled(thing: object) -> bool:
    """Return whether a class comes from compiled code: only such a class has wrappers of its own
    slots. (Cython and pybind11 put shared classes into modules without a file.)"""
    return isinstance(thing, type) and any(
        isinstance(part, WrapperDescriptorType) and part.__objclass__ is thing
        for part in vars(thing).values()
    )


@cache
def _installed(module: str) -> str | None:
    """Return the text by which a module is compared: the version of an installed one, the hash of a
    compiled one; "" for a module of Python, whose version is compared elsewhere; None for a module
    of the user, whose functions and classes are examined."""
    if (top := module.split(".")[0]) == "adaptmg":
        return _sources()
    try:
        spec = None if module in _MAIN else importlib.util.find_spec(module)
    except Exception:
        # made by hand, or sent to a worker that lacks it, or its package cannot be imported
        spec = None
    if spec is None:
        # modules without a file, which compiled packages make, are compared as their package
        package = module.rpartition(".")[0]
        return _installed(package) if package else None
    place = Path(spec.origin or next(iter(spec.submodule_search_locations or ()), ""))
    if {"site-packages", "dist-packages"} & set(place.parts):
        return _version(top)
    if spec.origin in ("built-in", "frozen") or any(
        Path(sysconfig.get_path(name)) in place.parents for name in ("stdlib", "platstdlib")
    ):
        return ""
    return _content(place) if place.suffix in (".so", ".pyd") else None


@cache
def _version(package: str) -> str | None:
    """Return the version of an installed package; None for a file outside all packages, which counts
    as the user's."""
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(package)
    owners = importlib.metadata.packages_distributions().get(package, ())
    return " ".join(map(importlib.metadata.version, owners)) or None


def _content(path: Path) -> str:
    """Return a hash of the content of a file; ValueError if the path is none."""
    if not path.is_file():
        raise ValueError(f"{path} must be a file")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


@cache
def _sources() -> str:
    """Return one hash of adaptmg's numerical sources; RuntimeError if one of them was edited after
    its import."""
    this_file = Path(__file__)
    content = hashlib.sha256()
    root = this_file.parents[1]
    for name, loaded in sorted(sys.modules["adaptmg"]._LOADED.items()):
        file = Path(name)
        if file != this_file and file.relative_to(root).parts[0] not in _NOT_NUMERICAL:
            if not file.exists() or file.stat().st_mtime_ns != loaded:
                raise RuntimeError(
                    f"{file} was edited after adaptmg was loaded: start Python again"
                )
            content.update(
                file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0"
            )
    return content.hexdigest()[:16]
