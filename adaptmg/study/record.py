"""Record: one run of a study as plain values, and the canonical text that identifies it.

A run is identified by the JSON of its parameters with sorted keys: the order of the parameters does not matter. Values
are equal where their texts are: 1, 1.0, True and "1" are four values (``1``, ``1.0``, ``true``, ``"1"``), a number of
numpy is Python's number of the same kind, NaN is itself (``NaN``), and 0.0 is not -0.0.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg.solver.fingerprint import Fingerprint

if TYPE_CHECKING:
    import pandas as pd

Scalar = bool | int | float | str | None
Value = Scalar | tuple["Value", ...]

#: columns that :meth:`adaptmg.study.Study.table` adds to parameters and results, and those it adds as details
RESERVED = ("status", "seconds", "error")
DETAILS = ("tries", "peak_memory", "started", "finished", "machine", "commit", "traceback")
#: characters of an error and of a traceback that are stored
MOST_ERROR, MOST_TRACEBACK = 4_000, 20_000
#: characters of all results of a run as JSON; longer texts are kept as files
MOST_RESULTS = 200_000


@dataclass(frozen=True, kw_only=True)
class Record:
    """One run: what it was given, what it returned, and where it ran."""

    parameters: dict[str, Value]  # the fixed ones too
    status: str  # "done" or "failed"
    results: dict[str, Scalar] = field(default_factory=dict)  # the path of a file where a result is kept as one
    error: str = ""  # type and text of the exception of a failed run
    seconds: float = 0.0  # wall time
    code: str = ""  # fingerprint, see :mod:`adaptmg.solver.fingerprint`
    versions: dict[str, str] = field(default_factory=dict)  # of Python and of the packages
    finished: str = ""  # UTC, ISO 8601
    traceback: str = ""  # of a failed run
    peak_memory: int = 0  # largest memory of the process during the run, bytes; 0 where the system does not say
    started: str = ""  # UTC, ISO 8601
    machine: str = ""
    commit: str = ""  # of adaptmg, where it lies in a git repository
    tries: int = 1  # number of starts: more than one where workers died
    files: dict[str, str] = field(default_factory=dict)  # results kept as files: path in the folder of the store


def _scalar(value: object) -> object:
    return value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value


def parameter_value(name: str, value: object) -> Value:
    """Return a number, string, bool, None or tuple of those; TypeError for anything else."""
    value = _scalar(value)
    if isinstance(value, tuple):
        return tuple(parameter_value(name, v) for v in value)
    if isinstance(value, str) and any("\ud800" <= c <= "\udfff" for c in value):
        raise ValueError(f"parameter {name!r} must be text that can be stored, got lone surrogates: {value!a}")
    if value is None or type(value) in (bool, int, float, str):
        return value
    raise TypeError(f"parameter {name!r} must be a number, string, bool, None or a tuple of those, got "
                    f"{checks.shown(value)}; pass a name or a number and build the object in the run function")


class WrongResults(TypeError):
    """A run function returns what cannot be stored."""


def plain_results(results: object, parameters: Mapping[str, Value]) -> dict[str, Scalar]:
    """Return the results of a run function, checked: a flat mapping of names to numbers, strings, bools or None."""
    if not isinstance(results, Mapping):
        raise WrongResults(f"the run function must return a dict of numbers, strings and bools, got "
                        f"{checks.shown(results)}")
    plain = {}
    for name, value in results.items():
        if not isinstance(name, str):
            raise WrongResults(f"the names of results must be strings, got {checks.shown(name)}")
        if name in parameters or name in RESERVED:
            taken = "a parameter" if name in parameters else "a column of the study"
            raise WrongResults(f"result {name!r} has the name of {taken}: rename it (e.g. 'solver_{name}')")
        value = _scalar(value)
        if value is not None and type(value) not in (bool, int, float, str):
            raise WrongResults(f"result {name!r} must be a number, string, bool or None, got {checks.shown(value)}; "
                            "reduce arrays to numbers, or return a numpy array, which is kept as a file")
        plain[name] = value
    length = len(json.dumps(plain))
    if length > MOST_RESULTS:
        raise ValueError(f"the results take {length} characters, at most {MOST_RESULTS} go into a row; return arrays, "
                         "which are kept as files")
    return plain


def bounded(text: str, most: int) -> str:
    """Return a text of at most ``most`` characters, its middle left out where it is longer."""
    if len(text) <= most:
        return text
    half = (most - 60) // 2
    return f"{text[:half]}\n... {len(text) - 2 * half} characters left out ...\n{text[-half:]}"


def canonical(parameters: Mapping[str, Value]) -> str:
    """Return the text that identifies a run."""
    return json.dumps(parameters, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def restored(value: Scalar | list) -> Value:
    """Undo what JSON does to tuples."""
    return tuple(map(restored, value)) if isinstance(value, list) else value


#: reasons that are listed
_MOST = 12


@dataclass(frozen=True, kw_only=True)
class StudyStatus:
    """Counts of the runs of a study, and why runs are stale or failed.

    Examples
    --------
    >>> study = am.Study(lambda n: {"square": n * n}, {"n": [1, 2]})
    >>> study.status().missing
    2
    """

    name: str  # of the study
    done: int  # stored and valid
    failed: int  # stored, valid and failed
    stale: int  # stored for another state of code, values or packages
    missing: int
    reasons: dict[str, int] = field(default_factory=dict)  # why runs are stale, with their number
    errors: dict[str, int] = field(default_factory=dict)  # errors of failed runs, with their number

    @property
    def total(self) -> int:
        """Runs of the study."""
        return self.done + self.failed + self.stale + self.missing

    def __repr__(self) -> str:
        lines = [f"Study {self.name!r}: {self.total} runs: {self.done} done, {self.failed} failed, {self.stale} stale, "
                 f"{self.missing} missing"]
        for title, counts in (("stale", self.reasons), ("failed", self.errors)):
            ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
            lines += [f"  {title}: {text} ({count})" for text, count in ordered[:_MOST]]
            if len(ordered) > _MOST:
                lines.append(f"  {title}: {len(ordered) - _MOST} more")
        return "\n".join(lines)


def reasons(stale: Iterable[Record], now: Fingerprint, versions: Mapping[str, str],
            origins: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Return why records are stale, with the number of records."""
    kinds = Counter((record.code, tuple(record.versions.items())) for record in stale)
    counts: Counter[str] = Counter()
    for (code, stored), count in kinds.items():
        then = dict(stored)
        changes = [f"{name} {then.get(name, 'none')} -> {versions.get(name, 'none')}"
                   for name in sorted({*then, *versions}) if then.get(name) != versions.get(name)]
        if code != now.code:
            changes += now.differences(origins.get(code, {}))
        for text in changes:
            counts[text] += count
    return dict(counts)


def frame(names: Sequence[str], rows: Sequence[tuple[Mapping[str, Value], Record | None, str]],
          details: bool = False) -> pd.DataFrame:
    """Return a table of runs: parameters by ``names``, results, status, seconds, error, and details."""
    import pandas as pd

    results = dict.fromkeys(name for _, record, _ in rows if record is not None for name in record.results)
    made: dict[str, list[object]] = {name: [point.get(name) for point, _, _ in rows] for name in names}
    # NaN where a row lacks a result, as a table of dicts has it
    made |= {name: [math.nan if record is None else record.results.get(name, math.nan) for _, record, _ in rows]
             for name in results}
    made["status"] = [status for _, _, status in rows]
    made["seconds"] = [math.nan if record is None else record.seconds for _, record, _ in rows]
    made["error"] = ["" if record is None else record.error for _, record, _ in rows]
    for name in DETAILS if details else ():
        made.setdefault(name, [None if record is None else getattr(record, name) for _, record, _ in rows])
    order = [*names, *results, *RESERVED, *(name for name in made if name in DETAILS and name not in results)]
    # texts that are not UTF-8 are refused by the text columns of pandas with pyarrow
    return pd.DataFrame({name: pd.Series(made[name], dtype=object if any(isinstance(v, str) for v in made[name])
                                         else None) for name in order})
