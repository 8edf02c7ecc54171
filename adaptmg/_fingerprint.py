"""Fingerprint: what a run depends on, part by part.

Seen are: the code of the run function and of every function and class of the user's own modules that it can reach
(own: not installed, not adaptmg); defaults, attributes of functions, variables of closures and globals that they read,
by value, and which function, class or module a name stands for; own modules that are imported inside a function, or
used as a value, by their whole text and the constants set in them; own compiled modules by their bytes; the modules of
adaptmg behind the names that are used, with all that those import (:mod:`adaptmg._fingerprint`); and the
versions of installed packages. Where ``eval``, ``exec`` or ``globals`` is called, all globals of that module count.

Not seen are: data files, environment variables, the time, the working directory; the state of libraries and of Python
(seeds of global generators, printing options, filters of warnings, contexts of ``decimal``, levels of loggers, classes
that are registered or derived elsewhere); code of an installed package that was edited or replaced at run time;
modules imported under a name made at run time; docstrings and annotations that are read; what an object leaves out of
the state it is pickled with. ``depends=`` of the study names such things.

The code of a function as text, without what changes nothing: comments, docstrings, annotations, line numbers.

It is the code that runs, instruction by instruction, not the text of the file, which may have been edited since it was
loaded, or not be there (notebooks, ``python -c``).

What a module that is loaded has and its file does not: values set at run time, and code that was edited since.

What a file gives its names is read from its compiled form: constants that are set once, and functions. A name that
functions set too (``global``) is theirs, and not compared.

Modules as parts of a fingerprint: installed ones by their version, the user's own by their text.

Where a module, function or class comes from: the user's own, adaptmg, or an installed package.

A module of the user's of which one cannot say what is used: its whole text, and all that it imports.

Comments, docstrings, and the annotations of functions play no part.

Which modules of adaptmg a run can reach, and what is in them.

From the modules where the names stand that the run function uses, one follows every import, those inside functions too;
``from adaptmg.problem import Coulomb`` leads to the module where ``Coulomb`` stands, not to all that the package
imports. So a case, an indicator or a picture that a run does not use may change. A module's hash is that of its
compiled code without docstrings: comments, blank lines and docstrings play no part. Studies, stores and the engine
themselves (this layer) are left out. Files are read again when they change; of a module that is loaded it also counts
whether it is the one in the file, and which of its constants and functions were replaced.

Values as text: equal texts where a function cannot tell the values apart.

Numbers, texts and containers of them by what they hold, arrays by their bytes, other objects by their class and the
state that they would be pickled with. What has no such state (open files, locks, generators) and generators of random
numbers, whose state the runs would change, have no text: :class:`NoText`.

The walk from a run function to all it reads: functions and classes one after the other, values as texts.
"""

from __future__ import annotations

import ast
import builtins
import copyreg
import ctypes
import dis
import functools
import hashlib
import importlib
import importlib.metadata
import importlib.util
import os
import platform
import random
import re
import sys
import sysconfig
import time
import types
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

__all__ = [
    "ADAPTMG",
    "INSTALLED",
    "OWN",
    "PACKAGES",
    "Fingerprint",
    "Given",
    "Modules",
    "NoText",
    "OwnText",
    "Texts",
    "Walk",
    "code_text",
    "constant_text",
    "edited",
    "environment",
    "fingerprint",
    "free_read",
    "given",
    "globals_read",
    "home_name",
    "home_of",
    "imports_in",
    "is_installed",
    "kind_of",
    "loaded_before",
    "nested",
    "own_text",
    "reached",
    "replaced",
    "set_values",
    "text_hash",
    "texts_in",
    "value_parts",
    "version_of",
    "whole_package",
]

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
    modules = reached(walk.roots)
    walk.from_values(replaced(modules))
    return Fingerprint(walk.parts | (reached(walk.roots) if walk.roots - set(modules) else modules))


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


#: instructions that do nothing, or only keep books
_IDLE = {"NOP", "CACHE", "RESUME", "PRECALL", "EXTENDED_ARG"}


def code_text(code: CodeType) -> str:
    """Instructions with their names and constants; of nested functions too."""
    flags = code.co_flags & 0x2AC  # *args, **kwargs, generator, coroutine
    lines = [f"def {code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount} {flags} "
             f"{code.co_varnames[:code.co_argcount + code.co_kwonlyargcount + 2]}"]
    steps = [step for step in dis.get_instructions(code) if step.opname not in _IDLE]
    for step, after in zip(steps, [*steps[1:], None], strict=True):
        # docstrings of classes inside
        if not (_stores_docstring(step) or (step.opname == "LOAD_CONST" and _stores_docstring(after))):
            lines.append(f"{step.opname} {_argument(step, code)}")
    # which instructions a ``try`` covers
    return "\n".join([*lines, code.co_exceptiontable.hex()])


def _stores_docstring(step: dis.Instruction | None) -> bool:
    return step is not None and step.opname == "STORE_NAME" and step.argval == "__doc__"


def _argument(step: dis.Instruction, code: CodeType) -> str:
    if step.opcode in dis.hasconst:
        # dis itself does not tell the names of keyword arguments
        return constant_text(code.co_consts[step.arg])
    # where a jump goes is a number of the instruction, without meaning after idle ones are gone, but as good as any
    return repr(step.argval)


def constant_text(value: object) -> str:
    """1, 1.0 and True differ, and sets have no order."""
    if isinstance(value, tuple):
        return f"({', '.join(map(constant_text, value))})"
    if isinstance(value, frozenset):
        return f"{{{', '.join(sorted(map(constant_text, value)))}}}"
    return code_text(value) if isinstance(value, CodeType) else f"{type(value).__name__} {value!r}"


def nested(code: CodeType) -> Iterator[CodeType]:
    """A function's code, and that of functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from nested(constant)


def globals_read(code: CodeType) -> list[tuple[str, ...]]:
    """Names of globals that are read, each with the attributes that are taken from it at once: ``("am", "solve")``."""
    found = []
    for part in nested(code):
        chain: list[str] | None = None
        for step in dis.get_instructions(part):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"):
                if chain:
                    found.append(tuple(chain))
                chain = [step.argval]
            elif chain and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
                chain.append(step.argval)
            elif step.opname not in _IDLE:
                if chain:
                    found.append(tuple(chain))
                chain = None
        if chain:
            found.append(tuple(chain))
    return list(dict.fromkeys(found))


def free_read(code: CodeType) -> dict[str, list[tuple[str, ...]]]:
    """Attributes that are taken at once from variables of a closure, by the name of the variable."""
    found: dict[str, list[tuple[str, ...]]] = {name: [] for name in code.co_freevars}
    for part in nested(code):
        steps = [step for step in dis.get_instructions(part) if step.opname not in _IDLE]
        for step, after in zip(steps, [*steps[1:], None], strict=True):
            if step.opname in ("LOAD_DEREF", "LOAD_CLASSDEREF", "LOAD_FROM_DICT_OR_DEREF") and step.argval in found:
                taken = after is not None and after.opname in ("LOAD_ATTR", "LOAD_METHOD")
                found[step.argval].append((after.argval,) if taken else ())
    return found


def imports_in(code: CodeType) -> list[str]:
    """Modules that are imported inside a function, with the names that are taken from them."""
    found = []
    for part in nested(code):
        module = ""
        for step in dis.get_instructions(part):
            if step.opname == "IMPORT_NAME":
                module = step.argval
                found.append(module)
            elif step.opname == "IMPORT_FROM":
                found.append(f"{module}.{step.argval}")
    return list(dict.fromkeys(found))


def texts_in(code: CodeType) -> list[str]:
    """Constant texts that may be names of modules."""
    found = (value for part in nested(code) for value in part.co_consts if isinstance(value, str))
    return [text for text in dict.fromkeys(found) if all(part.isidentifier() for part in text.split("."))]


_IMPORTED = time.time()
_SETTING = {dis.opmap["STORE_GLOBAL"], dis.opmap["DELETE_GLOBAL"]}
_CONSTANT = (type(None), bool, int, float, complex, str, bytes, tuple)


@dataclass(frozen=True)
class Given:
    """What the text of a module or class gives its names.

    Attributes
    ----------
    constants : dict of str to constant
    functions : dict of str to code
        Decorated ones too.
    classes : dict of str to Given
    """

    constants: dict[str, Any] = field(default_factory=dict)
    functions: dict[str, CodeType] = field(default_factory=dict)
    classes: dict[str, Given] = field(default_factory=dict)


def given(code: CodeType) -> Given:
    """From the compiled text of a module or of the body of a class."""
    found, made, previous = Given(), None, None
    times: Counter[str] = Counter()
    for step in dis.get_instructions(code):
        if previous is not None and previous.opcode in dis.hasconst and step.opname == "MAKE_FUNCTION":
            made = code.co_consts[previous.arg]
        elif step.opname in ("STORE_NAME", "DELETE_NAME", "IMPORT_STAR"):
            name = step.argval
            times[name] += 1
            if made is not None and made.co_name == name:
                # classes are made by calling their body
                is_class = "__qualname__" in made.co_names
                (found.classes if is_class else found.functions)[name] = given(made) if is_class else made
            elif previous is not None and previous.opname == "LOAD_CONST" and not name.startswith("__"):
                found.constants[name] = code.co_consts[previous.arg]
            made = None
        previous = step
    # to look into all functions takes long, and few set globals
    theirs = {step.argval for part in nested(code) if _SETTING.intersection(part.co_code[::2])
              for step in dis.get_instructions(part) if step.opcode in _SETTING}
    for names in (found.constants, found.functions, found.classes):
        for name in [name for name in names if times[name] > 1 or name in theirs]:
            del names[name]
    return found


def set_values(module: ModuleType, texts: Given) -> dict[str, Any]:
    """Names of a loaded module that have another value than its file gives them: constants, and functions of others."""
    values = dict(_differing(vars(module), texts, module.__name__))
    for name, inner in texts.classes.items():
        owner = vars(module).get(name)
        if isinstance(owner, type):
            values |= {f"{name}.{key}": value for key, value in _differing(vars(owner), inner, module.__name__)}
    return values


def _differing(now: Any, texts: Given, home: str) -> Iterator[tuple[str, Any]]:
    for name, then in texts.constants.items():
        # what stands there in the end may be made of it, such as a field of a dataclass
        if type(now.get(name, ...)) in _CONSTANT and constant_text(now[name]) != constant_text(then):
            yield name, now[name]
    for name in texts.functions:
        value = now.get(name)
        if isinstance(value, FunctionType) and value.__module__ != home and value.__code__.co_name != name:
            yield name, value


def edited(module: ModuleType, texts: Given) -> bool:
    """Whether functions of a loaded module are other ones than those in its file."""
    owners = [(vars(module), texts), *((vars(owner), inner) for name, inner in texts.classes.items()
                                       if isinstance(owner := vars(module).get(name), type))]
    for now, inner in owners:
        for name, code in inner.functions.items():
            value = now.get(name)
            value = getattr(value, "py_func", None) or getattr(value, "__wrapped__", value)
            if isinstance(value, FunctionType) and value.__code__.co_name == name \
                    and value.__module__ == module.__name__ and code_text(value.__code__) != code_text(code):
                return True
    return False


def loaded_before(changed: float) -> bool:
    """Whether this process may have loaded a file before it was changed; seconds since 1970."""
    return changed > _start() - 2.0


@cache
def _start() -> float:
    """When this process began, seconds since 1970; where the system does not say, when this module was loaded."""
    if sys.platform == "linux":
        try:
            with open("/proc/self/stat", encoding="ascii", errors="replace") as file:
                ticks = float(file.read().rpartition(")")[2].split()[19])
            with open("/proc/stat", encoding="ascii") as file:
                booted = next(float(line.split()[1]) for line in file if line.startswith("btime"))
            return booted + ticks / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError, IndexError, StopIteration):
            pass
    return _IMPORTED


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


OWN, ADAPTMG, INSTALLED = "own", "adaptmg", "installed"
#: on which the results of adaptmg depend, with itself
PACKAGES = ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")


@cache
def _installed_places() -> tuple[str, ...]:
    paths = sysconfig.get_paths()
    places = {os.path.realpath(paths[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places |= {os.path.realpath(path) for path in sys.path if Path(path).name in ("site-packages", "dist-packages")}
    return tuple(place + os.sep for place in places)


def kind_of(module: str | None) -> str:
    """What kind of module has a name; without a file it is installed, but for where the user types."""
    if not module or module in ("__main__", "__mp_main__"):
        return OWN
    if module.split(".")[0] == "adaptmg":
        return ADAPTMG
    if module.split(".")[0] in sys.stdlib_module_names:
        return INSTALLED
    file = getattr(sys.modules.get(module), "__file__", None)
    if not isinstance(file, str):
        found = sys.modules.get(module)
        folders = list(getattr(found, "__path__", ()))
        if folders:  # without __init__
            return INSTALLED if any(is_installed(os.path.join(folder, "")) for folder in folders) else OWN
        # else made by hand, or sent to a worker that lacks the module
        return INSTALLED if module in sys.builtin_module_names else OWN
    return INSTALLED if is_installed(file) or not file.endswith(".py") else OWN


def is_installed(file: str) -> bool:
    """Whether a file lies where packages are installed."""
    return os.path.realpath(file).startswith(_installed_places())


def home_name(thing: Any) -> str:
    """The bare name of the user's module where a function or class stands, the same whether it is run or imported.

    Run as a script it is in ``__main__``, here and, sent by value, on a worker: its code tells the file.
    """
    module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None) or ""
    if module != "__main__":
        return module.rpartition(".")[2]
    parts = vars(thing).values() if isinstance(thing, type) else [thing]
    files = [Path(part.__code__.co_filename) for part in parts if isinstance(part, FunctionType)]
    # cells of notebooks have files in name only, a new one each time
    return next((file.stem for file in files if file.suffix == ".py" and "ipykernel" not in str(file)), module)


@cache
def version_of(package: str) -> str:
    """Version of an installed package by the name it is imported under; that of Python for its own."""
    if package in sys.stdlib_module_names:
        return ".".join(map(str, sys.version_info[:3]))
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(sys.modules.get(package), "__version__", "unknown"))


@dataclass(frozen=True)
class OwnText:
    """What counts of a module.

    Attributes
    ----------
    content : str
    imports : list of str
        Full names; whether the last part of one is a module or a name in it, the text does not say.
    given : Given
        What it gives its names.
    """

    content: str
    imports: list[str] = field(default_factory=list)
    given: Given = field(default_factory=Given)


def own_text(text: str, name: str, package: str) -> OwnText:
    """Read a module.

    Parameters
    ----------
    text, name : str
        Of the module.
    package : str
        In which relative imports look.
    """
    try:
        tree = ast.parse(text, name)
        imports = list(dict.fromkeys(_imports(tree, package)))
        code = compile(_Plain().visit(tree), name, "exec", dont_inherit=True, optimize=2)
    except (SyntaxError, ValueError, RecursionError):
        return OwnText(text)
    return OwnText(code_text(code), imports, given(compile(text, name, "exec", dont_inherit=True)))


def _imports(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")
            outer = ".".join(parents[:len(parents) - node.level + 1]) if node.level else ""
            base = ".".join(filter(None, (outer, node.module)))
            yield from (base if alias.name == "*" else f"{base}.{alias.name}" for alias in node.names)


class _Plain(ast.NodeTransformer):
    """Without annotations of functions."""

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        given = node.args
        for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg):
            if argument is not None:
                argument.annotation = None
        node.returns = None
        return self.generic_visit(node)

    visit_AsyncFunctionDef = visit_FunctionDef


_ROOT = Path(__file__).parent
_FROM = re.compile(r"^[ \t]*from[ \t]+(adaptmg[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+(adaptmg[\w.]*)", re.MULTILINE)
#: modules that are loaded by name when they are first used
_QUOTED = re.compile(r"""["'](adaptmg(?:\.\w+)+)["']""")
_ALIAS = re.compile(r"^[ \t]*import[ \t]+adaptmg[ \t]+as[ \t]+(\w+)", re.MULTILINE)
#: no result depends on them
_NOT_COMPUTING = ("adaptmg.study.", "adaptmg.runtime.fingerprint")
_COMMENT = re.compile(r"#[^\n]*")


def reached(roots: Iterable[str]) -> dict[str, str]:
    """Hashes of the modules ``roots`` and of all they can reach, by name."""
    found: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in found or _file(name) is None or name == "adaptmg" or name.startswith(_NOT_COMPUTING):
            continue
        found.add(name)
        waiting.extend(_imported(name, *_stamp(name)))
    return {name: _hash(name, *_stamp(name)) + _edited(name) for name in sorted(found)}


def replaced(names: Iterable[str]) -> dict[str, Any]:
    """What was put in the place of constants and functions of loaded modules, by full name."""
    found = {}
    for name in names:
        module = sys.modules.get(name)
        if module is not None:
            values = set_values(module, _given(name, 2, *_stamp(name)))
            found |= {f"{name}.{key}": value for key, value in values.items()}
    return found


def _edited(name: str) -> str:
    """A mark for a module that was loaded before its file was changed: it computes something else than that says."""
    module, stamp = sys.modules.get(name), _stamp(name)
    if module is None or not loaded_before(stamp[0] / 1e9):
        return ""
    return " loaded before it was edited" if edited(module, _given(name, -1, *stamp)) else ""


def whole_package() -> list[str]:
    """All modules that compute, for functions of which one cannot say what they use."""
    names = (".".join(["adaptmg", *file.relative_to(_ROOT).with_suffix("").parts]) for file in _ROOT.rglob("*.py"))
    apart = ("adaptmg.cli", "adaptmg.plot", "adaptmg.export", "adaptmg.study", "adaptmg.__", *_NOT_COMPUTING)
    return [name.removesuffix(".__init__") for name in names if not name.startswith(apart)]


def home_of(module: str, name: str) -> str:
    """The module where a name of a module stands that is imported from it."""
    if _file(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    return _names(module, *_stamp(module)).get(name, module) if _is_package(module) else module


@cache
def _file(module: str) -> Path | None:
    """Source of a module, None if there is none of that name."""
    parts = module.split(".")
    base = _ROOT.joinpath(*parts[1:])
    if parts[0] != "adaptmg":
        return None
    return next((file for file in (base / "__init__.py", base.with_suffix(".py") if len(parts) > 1 else base)
                 if file.is_file()), None)


def _is_package(module: str) -> bool:
    file = _file(module)
    return file is not None and file.name == "__init__.py"


def _stamp(module: str) -> tuple[int, int]:
    """When the file of a module was changed (ns since 1970), and its size."""
    file = _file(module)
    if file is None:
        return 0, 0
    found = file.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=1024)
def _text(module: str, *stamp: int) -> str:
    file = _file(module)
    return "" if file is None else file.read_text(encoding="utf-8", errors="replace")


@lru_cache(maxsize=1024)
def _names(module: str, *stamp: int) -> dict[str, str]:
    """Names that a module takes from others, with the modules where they stand."""
    found = {}
    for match in _FROM.finditer(_text(module, *stamp)):
        for item in _COMMENT.sub("", match[2]).strip("() \t\n").split(","):
            words = item.split()
            if words:
                found[words[-1]] = match[1] if words[0] == "*" else home_of(match[1], words[0])
    return found


@lru_cache(maxsize=1024)
def _imported(module: str, *stamp: int) -> frozenset[str]:
    """Modules of adaptmg that one imports, at any depth of its text."""
    text = _text(module, *stamp)
    found = _IMPORT.findall(text) + _QUOTED.findall(text) + _by_attribute(text)
    return frozenset([*_names(module, *stamp).values(), *found])


def _by_attribute(text: str) -> list[str]:
    """Modules behind ``am.solve`` and the like, where ``import adaptmg as am`` stands."""
    import adaptmg

    found = []
    for name in _ALIAS.findall(text):
        for first, second in re.findall(rf"\b{name}\.(\w+)(?:\.(\w+))?", text):
            if first in adaptmg._HOME:
                found.append(adaptmg._HOME[first])
            elif _file(f"adaptmg.{first}") is not None:
                found.append(home_of(f"adaptmg.{first}", second) if second else f"adaptmg.{first}")
    return found


@lru_cache(maxsize=1024)
def _compiled(module: str, optimize: int, *stamp: int) -> CodeType | None:
    try:
        return compile(_text(module, *stamp), module, "exec", dont_inherit=True, optimize=optimize)
    except (SyntaxError, ValueError):
        return None


@lru_cache(maxsize=1024)
def _given(module: str, optimize: int, *stamp: int) -> Given:
    """What the file gives its names; functions are as this process has them if ``optimize`` is -1."""
    code = _compiled(module, optimize, *stamp)
    return Given() if code is None else given(code)


@lru_cache(maxsize=1024)
def _hash(module: str, *stamp: int) -> str:
    # without docstrings and assertions
    code = _compiled(module, 2, *stamp)
    content = _text(module, *stamp) if code is None else _code(code)
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()[:16]


def _code(code: CodeType) -> str:
    """All of a code object but its place in a file."""
    constants = [_code(value) if isinstance(value, CodeType) else f"{type(value).__name__} {_ordered(value)}"
                 for value in code.co_consts]
    return repr((code.co_name, code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount,
                 code.co_code.hex(), code.co_names, code.co_varnames, code.co_freevars, code.co_exceptiontable.hex(),
                 constants))


def _ordered(value: object) -> str:
    """Sets in one order, and numbers that are equal told apart."""
    if isinstance(value, frozenset):
        return str(sorted(map(repr, value)))
    if isinstance(value, tuple):
        return str([f"{type(item).__name__} {_ordered(item)}" for item in value])
    return repr(value)


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


_LOOKED_INTO = (FunctionType, type, ModuleType)
_SIMPLE = (bool, int, float, str)
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
        See :func:`adaptmg._fingerprint.fingerprint`.
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
            elif isinstance(value := getattr(builtins, variable, None), FunctionType) or type(value) in _SIMPLE:
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
        self.roots.add(home if mine else home_of(module, attribute))
        if type(value) in _SIMPLE or (isinstance(value, FunctionType | type) and home and kind_of(home) == OWN):
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
                self.roots.update(whole_package() if module == "adaptmg" else [module])
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
