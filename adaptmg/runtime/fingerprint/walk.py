"""The walk from a run function to all it reads: functions and classes one after the other, values as texts."""

from __future__ import annotations

import builtins
import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from adaptmg.runtime.fingerprint import package
from adaptmg.runtime.fingerprint.instructions import code_text, free_read, globals_read, imports_in, texts_in
from adaptmg.runtime.fingerprint.modules import Modules, text_hash
from adaptmg.runtime.fingerprint.origin import ADAPTMG, INSTALLED, OWN, home_name, kind_of
from adaptmg.runtime.fingerprint.values import NoText, Texts

__all__ = ["Walk"]

_LOOKED_INTO = (FunctionType, type, ModuleType)
_PLAIN = (bool, int, float, str)
#: what a class has beside what the user gave it, or what follows from that
_BOOKS = {"__doc__", "__module__", "__dict__", "__weakref__", "__annotations__", "__qualname__", "__firstlineno__",
          "__static_attributes__", "__slotnames__", "_value2member_map_", "class_type"}
#: with these a function may read any global, and with those any module
_ANY_GLOBAL, _ANY_MODULE = {"eval", "exec", "globals"}, {"__import__", "import_module"}
#: names of a notebook
_NOTEBOOK = {"In", "Out", "get_ipython", "exit", "quit", "open"}


class Walk:
    """Goes from a function to all it reads.

    Parameters
    ----------
    depends : mapping
        See :func:`adaptmg.runtime.fingerprint.fingerprint.fingerprint`.
    whose, remedy : str
        For messages: who depends on a part, and what helps apart from ``depends``.

    Attributes
    ----------
    parts : dict of str to str
        What was found.
    roots : set of str
        Modules of adaptmg that are used.
    """

    def __init__(self, depends: Mapping[str, Any], whose: str = "the run function depends on the",
                 remedy: str = "build it in the function, give its ingredients with fixed={...}, or ") -> None:
        self._whose, self._remedy = whose, remedy
        self.parts: dict[str, str] = {}
        self.roots: set[str] = set()
        self._seen: set[int] = set()
        self._kept: list[Any] = []  # so that no number of `_seen` is used twice
        self._waiting: list[FunctionType | type] = []  # rather than by recursion, which has a limit
        self._named: dict[str, list[int]] = {}
        self._depends = depends
        self._texts = Texts(self._refer)
        self._modules = Modules(self.parts, self._of_adaptmg, self._set_in_module)
        for name, value in depends.items():
            # a function is looked into
            content = value.read_bytes().hex() if isinstance(value, Path) else value
            self._part(f"depends {name}", self._texts.of(content))

    def from_function(self, function: FunctionType) -> None:
        """All parts, from the run function."""
        self._later(function)
        self._go_on()

    def from_values(self, values: Mapping[str, Any]) -> None:
        """Parts of values, by the name of what they stand in."""
        for where, value in values.items():
            self._value(f"value of {where}", where, value)
        self._go_on()

    def _part(self, name: str, text: str) -> None:
        """Two things of one name (lambdas) count both."""
        self.parts[name] = text_hash(self.parts.get(name, "") + text)

    def _go_on(self) -> None:
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

    # functions

    def _function(self, function: FunctionType) -> None:
        """The code of a function, and all it reads."""
        name, code = f"{home_name(function)}.{function.__qualname__}", function.__code__
        if kind_of(function.__module__) == ADAPTMG:
            self.roots.add(function.__module__)
        self._part(f"function {name}", code_text(code))
        for what, value in (("defaults", function.__defaults__), ("keyword defaults", function.__kwdefaults__)):
            if value:
                self._value(f"{what} of {name}", "", value)
        for attribute, value in sorted(vars(function).items()):
            self._value(f"attribute {attribute} of {name}", f"{name}.{attribute}", value)
        taken = free_read(code)
        for variable, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                value = cell.cell_contents
            except ValueError:
                continue  # not set
            for attributes in dict.fromkeys(taken[variable]) or [()]:
                self._read(f"{variable} around {name}", variable, value, attributes)
        read = globals_read(code)
        for variable, *attributes in read:
            if variable in function.__globals__:
                value = function.__globals__[variable]
                self._read(f"{home_name(function)}.{variable}", variable, value, tuple(attributes))
            elif isinstance(value := getattr(builtins, variable, None), FunctionType) or type(value) in _PLAIN:
                self._read(f"builtins.{variable}", variable, value, ())
        inside = function.__globals__.get("__package__") or ""
        for imported in imports_in(code):
            self._modules.imported(imported, inside)
        self._by_name(function, read)

    def _by_name(self, function: FunctionType, read: list[tuple[str, ...]]) -> None:
        """What a function can look up by a name: globals, and modules whose names stand in it."""
        if any(chain[0] in _ANY_GLOBAL and chain[0] not in function.__globals__ for chain in read):
            self._all(home_name(function), function.__globals__)
        if any(chain[-1] in _ANY_MODULE or chain[:2] == ("sys", "modules") for chain in read):
            for text in texts_in(function.__code__):
                self._modules.imported(text, "", unless_installed=True)
            if any("__name__" in chain for chain in read):
                self._all(home_name(function), function.__globals__)

    def _all(self, home: str, values: Mapping[str, Any]) -> None:
        """All names of a module that can be compared."""
        for variable, value in sorted(values.items()):
            if variable[0] != "_" and variable not in _NOTEBOOK and id(value) not in self._seen:
                try:
                    self._read(f"{home}.{variable}", variable, value, ())
                except TypeError:
                    continue

    def _read(self, where: str, variable: str, value: Any, attributes: tuple[str, ...]) -> None:
        """A variable, and the attributes that are taken from it."""
        if variable in self._depends:
            return
        for attribute in attributes:
            if not isinstance(value, ModuleType):
                break
            kind = kind_of(value.__name__)
            if value.__name__ != variable and kind != INSTALLED:
                self._part(f"value of {where}", f"module {home_name(value)}")
            if kind == INSTALLED:
                self._put_there(value, attributes[attributes.index(attribute):])
                break
            if kind == ADAPTMG and not hasattr(value, attribute):
                break
            if not hasattr(value, attribute):
                return  # the run will say so
            inner = getattr(value, attribute)
            if kind == ADAPTMG and not isinstance(inner, ModuleType):
                self._from_adaptmg(value.__name__, attribute, inner)
                return
            where, variable, value = f"{home_name(value)}.{attribute}", attribute, inner
            if variable in self._depends or where in self._depends:
                return
        self._value(f"value of {where}", where, value)

    def _put_there(self, module: ModuleType, attributes: tuple[str, ...]) -> None:
        """A function or class of the user's that was put into an installed module."""
        for attribute in attributes:
            inner = vars(module).get(attribute)
            if isinstance(inner, FunctionType | type) and inner.__module__ and kind_of(inner.__module__) == OWN:
                self._value(f"value of {module.__name__}.{attribute}", f"{module.__name__}.{attribute}", inner)
            if not isinstance(inner, ModuleType):
                return
            module = inner

    def _from_adaptmg(self, module: str, attribute: str, value: Any) -> None:
        home = getattr(value, "__module__", None)
        mine = bool(home) and kind_of(home) == ADAPTMG
        self.roots.add(home if mine else package.home_of(module, attribute))
        if type(value) in _PLAIN or (isinstance(value, FunctionType | type) and home and kind_of(home) == OWN):
            self._value(f"value of {module}.{attribute}", f"{module}.{attribute}", value)

    def _of_adaptmg(self, name: str) -> None:
        """A name of adaptmg that is imported inside a function."""
        module, _, last = name.rpartition(".")
        self._read(name, last, sys.modules.get(module) or importlib.import_module(module or name),
                   (last,) if module else ())

    def _set_in_module(self, home: str, values: Mapping[str, Any], everything: bool) -> None:
        if everything:
            self._all(home, values)
            return
        for name, value in values.items():
            self._value(f"value of {home}.{name}", f"{home}.{name}", value)

    # values

    def _value(self, part: str, variable: str, value: Any) -> None:
        if part in self._depends or (variable and _variable(variable) in self._depends):
            return
        try:
            text = self._texts.of(value)
        except NoText as error:
            raise TypeError(f"{self._whose} {part}, which cannot be told from another ({error}); {self._remedy}name "
                            f"what stands for it: depends={{{_variable(variable) or part!r}: ...}}") from error
        except RecursionError as error:
            raise TypeError(f"{self._whose} {part}, which is nested too deeply to be compared") from error
        # functions, classes and modules have parts of their own: here it counts which one it is
        if not (isinstance(value, _LOOKED_INTO) and text == f"{OWN} {variable}"):
            self._part(part, text)

    def _refer(self, thing: Any) -> str:
        """What stands for functions, classes and modules inside values."""
        module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None)
        # classes that are sent to workers lose the name of what they stand in
        name = "" if isinstance(thing, ModuleType) else thing.__name__ if isinstance(thing, type) else \
            getattr(thing, "__qualname__", thing.__name__)
        module = module if isinstance(module, str) else "builtins"
        kind = INSTALLED if module == "builtins" else kind_of(module)
        if kind != OWN:
            if kind == INSTALLED:
                self._modules.installed(module)
            else:
                self.roots.update(package.whole_package() if module == "adaptmg" else [module])
            return f"{kind} {module}.{name}"
        if isinstance(thing, ModuleType):
            self._modules.whole(thing.__name__)
        elif isinstance(thing, FunctionType | type):
            self._later(thing)
        text = f"{kind} {home_name(thing)}.{name}"
        # closures and lambdas of one name are told apart by their turn
        same = self._named.setdefault(text, [])
        if id(thing) not in same:
            same.append(id(thing))
            self._kept.append(thing)
        return f"{text} {same.index(id(thing)) + 1}" if same[0] != id(thing) else text

    def _class(self, owner: type) -> None:
        name = f"{home_name(owner)}.{owner.__name__}"
        shown = {key: value for key, value in vars(owner).items()
                 if key not in _BOOKS and type(value).__name__ not in ("member_descriptor", "getset_descriptor",
                                                                       "_abc_data")
                 and not ("__dataclass_fields__" in vars(owner) and _made_by_dataclass(value))}
        self._value(f"class {name}", name, [*owner.__bases__, *([] if type(owner) is type else [type(owner)])])
        for key, value in shown.items():
            self._value(f"{key} of class {name}", f"{name}.{key}", value)
        compiled = vars(owner).get("class_type")  # by numba
        for what in ("struct", "jit_props", "jit_methods", "jit_static_methods"):
            for key, value in getattr(compiled, what, {}).items():
                self._value(f"{what} {key} of class {name}", f"{name}.{key}", str(value) if what == "struct" else value)


def _variable(where: str) -> str:
    """Its bare name: ``LIMIT`` of ``script.LIMIT`` and of ``LIMIT around script.run``."""
    return where.split(" ")[0].rsplit(".", 1)[-1]


def _made_by_dataclass(value: Any) -> bool:
    """A method that follows from the fields, which count."""
    file = value.__code__.co_filename if isinstance(value, FunctionType) else ""
    return file == "<string>" or Path(file).name in ("dataclasses.py", "reprlib.py")
