"""The arguments of a case in a study file: checked by the types of its function, explained by its docstring."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from collections.abc import Callable, Sequence
from typing import Any

from adaptmg.cli.described.keys import SECTIONS, Check, Key, plain
from adaptmg.problem import checks

__all__ = ["case_keys", "given_arguments", "takes_law"]

#: arguments that are not numbers or texts
_OBJECTS = ("law", "flanges")
_SEE = re.compile(r"(?:[Aa]s in|see) :func:`~?adaptmg\.cases\.\w+\.(\w+)`")


def takes_law(function: Callable[..., Any]) -> bool:
    """Whether a case takes a law; others take a coefficient of friction alone."""
    return "law" in inspect.signature(function).parameters


def case_keys(name: str) -> dict[str, Key]:
    """The keys of [case] for a case: those of all cases, then its own.

    Raises
    ------
    ValueError
        If there is no such case.
    """
    from adaptmg.cases import get

    function = get(name).function
    own, words = inspect.signature(function).parameters, _meanings(function)
    common = dict(SECTIONS["case"])
    if not takes_law(function):
        del common["law"], common["limit"]
    return common | {key: Key(*_kind(str(item.annotation), words.get(key, ("", ""))[0]), words.get(key, ("", ""))[1],
                              _default(item.default)) for key, item in own.items() if key not in _OBJECTS}


def given_arguments(case: str, texts: Sequence[str]) -> dict[str, Any]:
    """Arguments of a case that the command line gives as NAME=VALUE; ValueError or TypeError for what is none."""
    known, common, found = case_keys(case), SECTIONS["case"], {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not value:
            raise ValueError(f"--set must be NAME=VALUE, got {checks.shown(text)}")
        if name in common:
            raise ValueError(f"--set {name}: that is an option of its own" if name != "case" else
                             "--set case: the case is named before the options")
        if name not in known:
            raise ValueError(f"the case {case} takes no {name!r}{checks.suggestion(name, known)}; it takes "
                             f"{', '.join(key for key in known if key not in common)}")
        found[name] = known[name].check(name, _read(value))
    return found


def _read(text: str) -> Any:
    """A number, true or false as in a study file; anything else is text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _kind(annotation: str, choices: str) -> tuple[Check, str]:
    """Check and words for an annotation, and choices in braces; arguments that may be None are left out instead."""
    if "{" in choices:
        known = tuple(map(ast.literal_eval, re.findall(r'"[^"]*"|\d+', choices)))
        return lambda name, value: checks.choice(name, value, known), " | ".join(map(str, known))
    kinds: dict[str, tuple[Check, str]] = {
        "float": (checks.quantity, "number"), "int": (checks.integer, "whole number"),
        "bool": (SECTIONS["measure"]["keep"].check, "true | false"), "str": (checks.boundary_name, "text")}
    return kinds.get(annotation.removesuffix(" | None"), (plain, "number, text or list"))


def _default(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:g}" if isinstance(value, int | float) else ""


def _meanings(function: Callable[..., Any]) -> dict[str, tuple[str, str]]:
    """What the section 'Parameters' of a docstring says, by argument: its type, and the words."""
    lines = inspect.getdoc(function).splitlines()
    found: dict[str, tuple[str, str]] = {}
    names: list[str] = []
    for line in lines[lines.index("Parameters") + 2:]:
        if line.startswith("Returns"):
            break
        if line and not line.startswith(" "):
            head, _, kind = line.partition(" : ")
            names = head.split(", ")
            found |= dict.fromkeys(names, (kind, kind if kind.startswith("see") else ""))
        else:
            found |= {name: (found[name][0], f"{found[name][1]} {line.strip()}".strip()) for name in names}
    return {name: (kind, _looked_up(name, text)) for name, (kind, text) in found.items()}


def _looked_up(name: str, text: str) -> str:
    """With the words of another case where the docstring refers to it, without markup, and with what is well known."""
    from adaptmg.cases import get

    refers = _SEE.search(text)
    if refers:
        text = _meanings(get(refers[1]).function).get(name, ("", ""))[1]
    known = {"young": "Young's modulus, Pa", "poisson": "Poisson's ratio"}
    return text.replace("Pa, and a number", known.get(name, "Pa, and a number")).replace("``", "").replace("`", "")
