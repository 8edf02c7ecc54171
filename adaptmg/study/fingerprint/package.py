"""Which modules of adaptmg a run can reach, and what is in them.

From the modules where the names stand that the run function uses, one follows every import, those inside functions too;
``from adaptmg.problem import Coulomb`` leads to the module where ``Coulomb`` stands, not to all that the package
imports. So a case, an indicator or a picture that a run does not use may change. A module's hash is that of its
compiled code without docstrings: comments, blank lines and docstrings play no part. Studies, stores and the engine
themselves (this layer) are left out.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import CodeType

__all__ = ["home_of", "reached", "whole_package"]

_ROOT = Path(__file__).parents[2]
_FROM = re.compile(r"^[ \t]*from[ \t]+(adaptmg[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+(adaptmg[\w.]*)", re.MULTILINE)
#: modules that are loaded by name when they are first used
_QUOTED = re.compile(r"""["'](adaptmg(?:\.\w+)+)["']""")
_ALIAS = re.compile(r"^[ \t]*import[ \t]+adaptmg[ \t]+as[ \t]+(\w+)", re.MULTILINE)
_COMMENT = re.compile(r"#[^\n]*")


def reached(roots: Iterable[str]) -> dict[str, str]:
    """Hashes of the modules ``roots`` and of all they can reach, by name."""
    found: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in found or _file(name) is None or name == "adaptmg" or name.startswith("adaptmg.study."):
            continue
        found.add(name)
        waiting.extend(_imported(name))
    return {name: _hash(name) for name in sorted(found)}


def whole_package() -> list[str]:
    """All modules that compute, for functions of which one cannot say what they use."""
    names = (".".join(["adaptmg", *file.relative_to(_ROOT).with_suffix("").parts]) for file in _ROOT.rglob("*.py"))
    apart = ("adaptmg.cli", "adaptmg.plot", "adaptmg.export", "adaptmg.study", "adaptmg.__")
    return [name.removesuffix(".__init__") for name in names if not name.startswith(apart)]


@cache
def home_of(module: str, name: str) -> str:
    """The module where a name of a module stands that is imported from it."""
    if _file(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    return _names(module).get(name, module) if _is_package(module) else module


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


@cache
def _text(module: str) -> str:
    file = _file(module)
    return "" if file is None else file.read_text(encoding="utf-8", errors="replace")


@cache
def _names(module: str) -> dict[str, str]:
    """Names that a module takes from others, with the modules where they stand."""
    found = {}
    for match in _FROM.finditer(_text(module)):
        for item in _COMMENT.sub("", match[2]).strip("() \t\n").split(","):
            words = item.split()
            if words:
                found[words[-1]] = match[1] if words[0] == "*" else home_of(match[1], words[0])
    return found


@cache
def _imported(module: str) -> frozenset[str]:
    """Modules of adaptmg that one imports, at any depth of its text."""
    text = _text(module)
    return frozenset([*_names(module).values(), *_IMPORT.findall(text), *_QUOTED.findall(text), *_by_attribute(text)])


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


@cache
def _hash(module: str) -> str:
    text = _text(module)
    try:
        # without docstrings and assertions
        content = _code(compile(text, module, "exec", dont_inherit=True, optimize=2))
    except (SyntaxError, ValueError):
        content = text
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()[:16]


def _code(code: CodeType) -> str:
    """All of a code object but its place in a file."""
    constants = [_code(value) if isinstance(value, CodeType) else f"{type(value).__name__} {_ordered(value)}"
                 for value in code.co_consts]
    return repr((code.co_name, code.co_flags, code.co_argcount, code.co_kwonlyargcount, code.co_code.hex(),
                 code.co_names, code.co_varnames, code.co_freevars, constants))


def _ordered(value: object) -> str:
    """Sets in one order, and numbers that are equal told apart."""
    if isinstance(value, frozenset):
        return str(sorted(map(repr, value)))
    if isinstance(value, tuple):
        return str([f"{type(item).__name__} {_ordered(item)}" for item in value])
    return repr(value)
