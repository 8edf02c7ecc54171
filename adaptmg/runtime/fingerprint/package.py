"""Which modules of adaptmg a run can reach, and what is in them.

From the modules where the names stand that the run function uses, one follows every import, those inside functions too;
``from adaptmg.problem import Coulomb`` leads to the module where ``Coulomb`` stands, not to all that the package
imports. So a case, an indicator or a picture that a run does not use may change. A module's hash is that of its
compiled code without docstrings: comments, blank lines and docstrings play no part. Studies, stores and the engine
themselves (this layer) are left out. Files are read again when they change; of a module that is loaded it also counts
whether it is the one in the file, and which of its constants and functions were replaced.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Iterable
from functools import cache, lru_cache
from pathlib import Path
from types import CodeType
from typing import Any

from adaptmg.runtime.fingerprint.loaded import Given, edited, given, loaded_before, set_values

__all__ = ["home_of", "reached", "replaced", "whole_package"]

_ROOT = Path(__file__).parents[2]
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
