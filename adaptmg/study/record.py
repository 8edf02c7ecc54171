"""Record: one run of a study as plain values, and the canonical text by which a run is known.

A run is known by the JSON of its parameters with sorted keys, so the order in which parameters are given does not
matter. Values are the same where their texts are: 1, 1.0, True and "1" are four different values (``1``, ``1.0``,
``true``, ``"1"``), a number of numpy is Python's number of the same kind, NaN is itself (``NaN``), and 0.0 is not -0.0.

How far a study is, and why what is stored cannot be taken.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from json.encoder import encode_basestring
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._fingerprint import Fingerprint

__all__ = ["DETAILS", "RESERVED", "Record", "Scalar", "StudyStatus", "Value", "bounded", "canonical", "parameter_value",
           "plain_results", "reasons", "restored"]

Scalar = bool | int | float | str | None
Value = Scalar | tuple["Value", ...]

#: columns that :meth:`adaptmg.study.Study.table` adds to parameters and results
RESERVED = ("status", "seconds", "error")
#: columns that it adds beside those when it is asked for details
DETAILS = ("tries", "peak_memory", "started", "finished", "machine", "commit", "traceback")

#: characters of an error and of a traceback that are stored
MOST_ERROR, MOST_TRACEBACK = 4_000, 20_000
#: characters of all results of a run as JSON; longer texts are kept as files
MOST_RESULTS = 200_000


@dataclass(frozen=True, kw_only=True)
class Record:
    """What is known of one run.

    Attributes
    ----------
    parameters : dict
        All of them, the fixed ones too.
    status : {"done", "failed"}
    results : dict of str to bool, int, float, str or None
        Empty where the run failed. A result that is kept as a file stands there with the name of the file.
    error : str
        Type and text of the exception of a failed run, else empty.
    seconds : float
        Wall time of the run.
    code : str
        Fingerprint of what the run depends on, see :mod:`adaptmg._fingerprint`.
    versions : dict of str to str
        Of Python and of the packages the results depend on.
    finished, started : str
        When, UTC, ISO 8601.
    traceback : str
        Of a failed run, its middle left out where it is long.
    peak_memory : int
        The most memory that the process held during the run, bytes; 0 where the system does not say.
    machine : str
        On which it ran.
    commit : str
        Of adaptmg, where it lies in a git repository.
    tries : int
        How often it was started until it came to this end: more than once where workers died.
    files : dict of str to str
        Results that are kept as files, by name of the result: path from the folder of the store's files.
    """

    parameters: dict[str, Value]
    status: str
    results: dict[str, Scalar] = field(default_factory=dict)
    error: str = ""
    seconds: float = 0.0
    code: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    finished: str = ""
    traceback: str = ""
    peak_memory: int = 0
    started: str = ""
    machine: str = ""
    commit: str = ""
    tries: int = 1
    files: dict[str, str] = field(default_factory=dict)


def _scalar(value: Any) -> Any:
    """Numpy scalars, and arrays without an axis, as Python's own."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value


def parameter_value(name: str, value: Any) -> Value:
    """``value`` as a plain number, string, bool, None or tuple of those; TypeError for anything else."""
    value = _scalar(value)
    if isinstance(value, tuple):
        return tuple(parameter_value(name, v) for v in value)
    if isinstance(value, str) and any("\ud800" <= c <= "\udfff" for c in value):
        raise ValueError(f"parameter {name!r} must be text that can be stored, got lone surrogates: {value!a}")
    if value is None or type(value) in (bool, int, float, str):
        return value
    raise TypeError(f"parameter {name!r} must be a number, string, bool, None or a tuple of those, got "
                    f"{checks.shown(value)}; pass a name or a number and build the object in the run function")


def plain_results(results: Any, parameters: Mapping[str, Value]) -> dict[str, Scalar]:
    """What a run function returned, checked: a flat mapping of names to numbers, strings, bools or None."""
    if not isinstance(results, Mapping):
        raise TypeError(f"the run function must return a dict of numbers, strings and bools, got "
                        f"{checks.shown(results)}")
    plain = {}
    for name, value in results.items():
        if not isinstance(name, str):
            raise TypeError(f"the names of results must be strings, got {checks.shown(name)}")
        if name in parameters or name in RESERVED:
            taken = "a parameter" if name in parameters else "a column of the study"
            raise ValueError(f"result {name!r} has the name of {taken}: rename it (e.g. 'solver_{name}')")
        value = _scalar(value)
        if value is not None and type(value) not in (bool, int, float, str):
            raise TypeError(f"result {name!r} must be a number, string, bool or None, got {checks.shown(value)}; "
                            "reduce arrays to numbers, or return a numpy array, which is kept as a file")
        plain[name] = value
    return plain


def check_size(results: Mapping[str, Scalar]) -> None:
    """ValueError if results are too long, or of numbers too long, to be stored in a row."""
    length = len(json.dumps(results))
    if length > MOST_RESULTS:
        raise ValueError(f"the results take {length} characters, at most {MOST_RESULTS} go into a row; return arrays, "
                         "which are kept as files")


def bounded(text: str, most: int) -> str:
    """A text with its middle left out where it is longer than ``most`` characters."""
    if len(text) <= most:
        return text
    half = (most - 60) // 2
    return f"{text[:half]}\n... {len(text) - 2 * half} characters left out ...\n{text[-half:]}"


def canonical(parameters: Mapping[str, Value]) -> str:
    """The text by which a run is known."""
    return "{" + ",".join([f"{_encoded(name)}:{_encoded(parameters[name])}" for name in sorted(parameters)]) + "}"


def _encoded(value: Value) -> str:
    """As ``json.dumps(value, separators=(",", ":"), ensure_ascii=False)``, five times as fast for what is short."""
    kind = type(value)
    if kind is str:
        return encode_basestring(value)
    if kind is int:
        return int.__repr__(value)
    if kind is float and value - value == 0:
        return float.__repr__(value)
    if kind is tuple:
        return f"[{','.join(map(_encoded, value))}]"
    return json.dumps(value)


def restored(value: Any) -> Any:
    """Undo what JSON does to tuples."""
    if isinstance(value, list):
        return tuple(restored(v) for v in value)
    return value


#: reasons that are told one by one
_MOST = 12


@dataclass(frozen=True, kw_only=True)
class StudyStatus:
    """Counts of the runs of a study.

    Attributes
    ----------
    name : str
    done, failed, stale, missing : int
        Stored and valid; stored, valid and failed; stored for another state of code, values or packages; not there.
    reasons : dict of str to int
        Why runs are stale, and how many for that reason; one run may have several.
    errors : dict of str to int
        Errors of failed runs, and how many have each.
    """

    name: str
    done: int
    failed: int
    stale: int
    missing: int
    reasons: dict[str, int] = field(default_factory=dict)
    errors: dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Runs of the study."""
        return self.done + self.failed + self.stale + self.missing

    def __repr__(self) -> str:
        lines = [f"Study {self.name!r}: {self.total} runs: {self.done} done, {self.failed} failed, {self.stale} stale, "
                 f"{self.missing} missing"]
        for title, found in (("stale", self.reasons), ("failed", self.errors)):
            ordered = sorted(found.items(), key=lambda item: (-item[1], item[0]))
            lines += [f"  {title}: {text} ({count})" for text, count in ordered[:_MOST]]
            if len(ordered) > _MOST:
                lines.append(f"  {title}: {len(ordered) - _MOST} more")
        return "\n".join(lines)


def reasons(stale: Iterable[Record], now: Fingerprint, versions: Mapping[str, str],
            origins: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Why records are stale, with the number of records."""
    kinds: Counter[tuple[str, tuple[tuple[str, str], ...]]] = Counter(
        (record.code, tuple(record.versions.items())) for record in stale)
    found: Counter[str] = Counter()
    for (code, stored), count in kinds.items():
        then = dict(stored)
        told = [f"{name} {then.get(name, 'none')} -> {versions.get(name, 'none')}"
                for name in sorted({*then, *versions}) if then.get(name) != versions.get(name)]
        if code != now.code:
            told += now.differences(origins[code]) if code in origins else \
                ["stored by a version of adaptmg that did not say what a run depends on"]
        for text in told:
            found[text] += count
    return dict(found)
