"""The code of a function as text, without what changes nothing: comments, docstrings, annotations, line numbers.

It is the code that runs, instruction by instruction, not the text of the file, which may have been edited since it was
loaded, or not be there (notebooks, ``python -c``).
"""

from __future__ import annotations

import dis
from collections.abc import Iterator
from types import CodeType

__all__ = ["code_text", "constant_text", "free_read", "globals_read", "imports_in", "nested", "texts_in"]

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
