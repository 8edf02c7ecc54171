"""Study files: TOML that says case, hierarchy, solver, load path, adaptation, what to measure and what to vary.

Every message about a file begins with its name and the line.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from adaptmg.cli.described.arguments import case_keys
from adaptmg.cli.described.design import design_of
from adaptmg.cli.described.keys import OPEN, SECTIONS, SETTINGS, Check, Key
from adaptmg.cli.described.meanings import MEANINGS
from adaptmg.cli.described.toml import TomlFile
from adaptmg.problem import checks
from adaptmg.study.designs import Design

__all__ = ["StudyFile", "read"]

#: keys outside sections
_TOP = ("name", "store")
#: what keys are called elsewhere
_ALIASES = {"mu": "friction", "coefficient": "friction", "E": "young", "youngs_modulus": "young", "nu": "poisson",
            "poisson_ratio": "poisson", "tol": "rtol", "tolerance": "rtol", "maxit": "max_cycles",
            "max_iterations": "max_cycles", "presweeps": "pre", "postsweeps": "post", "levels": "divisions",
            "cells": "divisions", "h": "sizes", "name": "case", "type": "method", "solver": "method",
            "quantities": "columns"}


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """What a file says.

    Attributes
    ----------
    name : str
        Of the study.
    store : Path
    design : Design
        Of the settings that vary, as ``"section.key"``.
    fixed : dict
        The other settings, by the same names; ``measure.columns`` and the like too.
    options : dict
        Of :meth:`adaptmg.study.Study.run`.
    file : TomlFile
    places : dict
        By setting the path of its key in the file.
    """

    name: str
    store: Path
    design: Design
    fixed: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict)
    file: TomlFile
    places: dict[str, tuple[str, ...]]


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read a study file.

    Raises
    ------
    ValueError
        For what is wrong in it: the message says file, line, and what to write instead.
    OSError
        If it cannot be read.
    """
    return _Reader(TomlFile(path)).result()


class _Reader:
    """Checks one file."""

    def __init__(self, file: TomlFile) -> None:
        self._file, self._content = file, file.content
        #: by setting the path of its key in its section, and in [vary]
        self._places: dict[str, tuple[str, ...]] = {}
        self._varied: dict[str, tuple[str, ...]] = {}

    def result(self) -> StudyFile:
        """The file, checked."""
        self._check_sections()
        varied = self._flat("vary", ("vary",), self._content["vary"])
        keys = {section: dict(SECTIONS[section]) for section in SECTIONS}
        keys["case"] = self._case_keys(varied)
        fixed = {f"{section}.{key}": self._checked(keys, section, key, value, self._places[f"{section}.{key}"])
                 for section in SETTINGS for key, value in self._given(section).items()}
        design = self._design(keys, varied)
        fixed = {name: value for name, value in fixed.items() if name not in design.names} | self._measures(keys)
        options = {key: self._checked(keys, "run", key, value, ("run", key))
                   for key, value in self._given("run").items()}
        self._check_options(options, [*fixed, *design.names])
        name = self._content.get("name", self._file.path.stem)
        store = checks.file_path("store", self._content.get("store", f"results/{name}.sqlite"))
        return StudyFile(name=name, store=store, design=design, fixed=fixed, options=options, file=self._file,
                         places=self._places | self._varied)

    def _check_sections(self) -> None:
        for name, value in self._content.items():
            if name in _TOP:
                self._check_text(name, value)
            elif name not in SECTIONS:
                owners = [section for section in SECTIONS if name in SECTIONS[section]]
                hint = f" (it belongs below [{owners[0]}])" if owners else checks.suggestion(name, [*SECTIONS, *_TOP])
                raise self._file.wrong(f"there is no section {name!r}{hint}; there are {', '.join(SECTIONS)}, and "
                                       f"before them {' and '.join(_TOP)}", name)
            elif not isinstance(value, dict):
                raise self._file.wrong(f"{name} must be one section, [{name}], got {checks.shown(value)}", name)
        for section in ("case", "measure", "vary"):
            if section not in self._content:
                raise self._file.wrong(f"there is no section [{section}] ({_PURPOSE[section]}); 'adaptmg study "
                                       "--template greco_bar' prints a file to begin with")
        if not self._content["vary"]:
            raise self._file.wrong("[vary] is empty: name a setting and its values, such as \"solver.pre\" = [1, 2]",
                                   "vary")

    def _check_text(self, name: str, value: Any) -> None:
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise self._file.wrong(f"{name} must be text, got {checks.shown(value)}", name)
        if name == "name" and (set(value) & set("/\\") or value.startswith(".") or len(value) > 100):
            raise self._file.wrong(f"name must be a name, which becomes that of files, got {checks.shown(value)}", name)

    def _flat(self, top: str, place: tuple[str, ...], table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
        """Keys of tables in each other, with dots between: ``case.friction`` is the same as ``"case.friction"``."""
        found: dict[str, Any] = {}
        for key, value in table.items():
            name, path = f"{before}{key}", (*place, key)
            inner = self._flat(top, path, value, f"{name}.") if isinstance(value, dict) and value else {name: value}
            for twice in set(inner) & set(found):
                raise self._file.wrong(f"[{top}] names {twice} twice", *path)
            found |= inner
            if name in inner:
                if top == "vary":
                    self._varied[name] = path
                else:
                    self._places[f"{top}.{name}"] = path
        return found

    def _given(self, section: str) -> dict[str, Any]:
        """The keys of a section; those of open ones may have dots, and values by name are a key each."""
        table = self._content.get(section, {})
        if section in OPEN:
            return self._flat(section, (section,), table)
        found: dict[str, Any] = {}
        for key, value in table.items():
            inner = {key: value}
            known = SECTIONS[section].get(key)
            if known is not None and known.named:
                if not isinstance(value, dict):
                    raise self._file.wrong(f"{section}.{key} must be values by name, {key} = {{NAME = {known.values}}}"
                                           f", got {checks.shown(value)}", section, key)
                inner = {f"{key}.{name}": item for name, item in value.items()}
                self._places |= {f"{section}.{key}.{name}": (section, key, name) for name in value}
            self._places[f"{section}.{key}"] = (section, key)
            found |= inner
        return found

    def _case_keys(self, varied: Mapping[str, Any]) -> dict[str, Key]:
        """The keys that all cases take which are named."""
        said = self._content["case"].get("case")
        several = varied.get("case.case")
        if said is None and several is None:
            raise self._file.wrong("[case] needs case = \"NAME\", see 'adaptmg cases'", "case")
        found: list[dict[str, Key]] = []
        for name in [said] if several is None else several if isinstance(several, list) else []:
            try:
                found.append(case_keys(checks.boundary_name("case", name)))
            except (ValueError, TypeError) as error:
                raise self._file.wrong(str(error), *(("case", "case") if several is None else
                                                     self._varied["case.case"])) from None
            known = found[-1]
            given = [(f"case.{key}", self._places) for key in self._given("case")]
            for setting, places in [*given, *((setting, self._varied) for setting in varied)]:
                key = setting.removeprefix("case.")
                if setting.startswith("case.") and key not in known:
                    raise self._file.wrong(f"the case {name} takes no {key!r}{_near(key, known)}; it takes "
                                           f"{', '.join(known)}", *places[setting])
        return found[0] if found else SECTIONS["case"]

    def _checked(self, keys: Mapping[str, Mapping[str, Key]], section: str, key: str, value: Any,
                 place: Iterable[str]) -> Any:
        known = keys[section]
        found = _of_name(known, key)
        if found is None and section not in OPEN:
            raise self._file.wrong(f"[{section}] has no key {key!r}{_near(key, known)}; it has "
                                   f"{', '.join(known)}", *place)
        check: Check = OPEN[section] if found is None else found.check
        try:
            return check(f"{section}.{key}", value)
        except (TypeError, ValueError) as error:
            raise self._file.wrong(str(error), *place) from None

    def _measures(self, keys: Mapping[str, Mapping[str, Key]]) -> dict[str, Any]:
        """The settings of [measure]."""
        found = {f"measure.{key}": self._checked(keys, "measure", key, value, self._places[f"measure.{key}"])
                 for key, value in self._given("measure").items()}
        for column in found.get("measure.columns", ()):
            if column not in MEANINGS:
                raise self._file.wrong(f"nothing measures {column!r}{checks.suggestion(column, MEANINGS)}; there are "
                                       f"{', '.join(MEANINGS)}", "measure", "columns")
        return found

    def _design(self, keys: Mapping[str, Mapping[str, Key]], varied: Mapping[str, Any]) -> Design:
        values: dict[str, list[Any]] = {}
        for name, given in varied.items():
            section, _, key = name.partition(".")
            if section not in SETTINGS or not key or (_of_name(keys[section], key) is None and section not in OPEN):
                known = [f"{s}.{k}" for s in SETTINGS for k in keys[s]]
                raise self._file.wrong(f"{name!r} cannot be varied{checks.suggestion(name, known)}: name a setting as "
                                       "\"section.key\"", *self._varied.get(name, ("vary",)))
            place = self._varied[name]
            if not isinstance(given, list) or not given:
                raise self._file.wrong(f"{name} must be a list of values" + (", got an empty one" if given == [] else
                                       f", got {checks.shown(given)}"), *place)
            values[name] = [self._checked(keys, section, key, value, place) for value in given]
        options = {key: self._checked(keys, "design", key, value, ("design", key))
                   for key, value in self._given("design").items()}
        try:
            return design_of(values, **options)
        except (TypeError, ValueError) as error:
            named = [name for name in values if f"'{name}'" in str(error)]
            place = self._varied[named[0]] if named else ("design",) if "design" in self._content else ("vary",)
            words = re.sub(r"(?:parameters|ranges)\['([^']*)'\]", r"\1", str(error))
            raise self._file.wrong(words, *place) from None

    def _check_options(self, options: Mapping[str, Any], settings: list[str]) -> None:
        cost, known = options.get("cost"), [*settings, *MEANINGS, "seconds"]
        if cost is not None and cost not in known:
            raise self._file.wrong(f"run.cost: there is no setting or measure {cost!r}{checks.suggestion(cost, known)}",
                                   "run", "cost")


def _of_name(known: Mapping[str, Key], name: str) -> Key | None:
    """The key of this name, which may be one of values by name: ``points`` for ``points.A``."""
    head, _, rest = name.partition(".")
    if name in known:
        return None if known[name].named else known[name]
    return known[head] if rest and head in known and known[head].named else None


def _near(key: str, known: Iterable[str]) -> str:
    """What may be meant by a key that is none of those known."""
    alias = _ALIASES.get(key)
    return f" (did you mean {alias!r}?)" if alias in known else checks.suggestion(key, known)


_PURPOSE = {"case": "which problem", "measure": "what the table shows; it may be empty", "vary": "what varies"}
