"""What a module that is loaded has and its file does not: values set at run time, and code that was edited since.

What a file gives its names is read from its compiled form: constants that are set once, and functions. A name that
functions set too (``global``) is theirs, and not compared.
"""

from __future__ import annotations

import dis
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

from adaptmg.runtime.fingerprint.instructions import code_text, constant_text, nested

__all__ = ["Given", "edited", "given", "loaded_before", "set_values"]

_IMPORTED = time.time()
_SETTING = {dis.opmap["STORE_GLOBAL"], dis.opmap["DELETE_GLOBAL"]}
_PLAIN = (type(None), bool, int, float, complex, str, bytes, tuple)


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
        if type(now.get(name, ...)) in _PLAIN and constant_text(now[name]) != constant_text(then):
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
