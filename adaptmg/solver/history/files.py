"""The folder of a load path: ``path.json`` for what all steps share, and a result file a step.

Every step file carries its number and the key of the path, a hash of what ``path.json`` says, so that files that were
swapped, or come from another folder, are told from those that belong there. Only the first step carries the mesh.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg.problem import check_arrays, checks
from adaptmg.runtime.atomic import make_folder, write_bytes
from adaptmg.solver.result.archive import DAMAGES
from adaptmg.solver.result.result import Result, loaded
from adaptmg.solver.result.result_file import write_result

__all__ = ["HEAD", "PathHead", "read", "step_file", "write", "write_head", "write_step"]

HEAD = "path.json"
_FORMAT = 3
#: a path.json of a million steps is some 20 MB
_MOST_BYTES, _MOST_STEPS = 2**28, 10**7
_AGAIN = "remove it and those after it to have these steps solved again"


@dataclass(frozen=True)
class PathHead:
    """What all steps share; see :class:`adaptmg.PathResult`. Without a fingerprint ``norms``, of the displacement of
    each step, tell paths of the same factors apart."""

    factors: Mapping[str, np.ndarray]
    steps: int
    fingerprint: Mapping[str, Any]
    norms: tuple[float, ...] = ()

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"steps": self.steps, "factors": {name: list(map(float, v)) for name, v in self.factors.items()},
                "norms": list(self.norms), "fingerprint": dict(self.fingerprint)}

    @property
    def key(self) -> str:
        """By which step files are known as those of this path."""
        return hashlib.sha256(json.dumps(self.plain, sort_keys=True).encode()).hexdigest()


def step_file(folder: Path, step: int) -> Path:
    """Where a step is kept."""
    return folder / f"step_{step:04d}.npz"


def write_head(folder: Path, head: PathHead) -> None:
    """Write what all steps share."""
    text = json.dumps({"format": _FORMAT, "key": head.key, **head.plain}, indent=1)
    write_bytes(folder / HEAD, text.encode())


def write_step(folder: Path, head: PathHead, step: int, result: Result) -> None:
    """Write a step, whole or not at all."""
    write_result(step_file(folder, step), result if step == 0 else replace(result, mesh=None),
                 {"step": step, "key": head.key})


def write(folder: Path, results: Sequence[Result], factors: Mapping[str, np.ndarray], steps: int,
          fingerprint: Mapping[str, Any]) -> None:
    """Write a whole path; ValueError if the folder holds one."""
    if (folder / HEAD).exists():
        raise ValueError(f"{folder} holds a load path already: give another folder, or remove it")
    make_folder("folder", folder)
    head = PathHead(factors, steps, fingerprint, tuple(float(np.linalg.norm(r.displacement)) for r in results))
    for k, result in enumerate(results):
        write_step(folder, head, k, result)
    write_head(folder, head)


def read(folder: Path) -> tuple[PathHead, tuple[Result, ...]]:
    """Read the head and the steps that are there, from the first on.

    Raises
    ------
    ValueError
        See :meth:`adaptmg.PathResult.load`.
    """
    head = _read_head(folder)
    found = sorted(int(match[1]) for name in os.listdir(folder) if (match := re.fullmatch(r"step_(\d+)\.npz", name)))
    results: list[Result] = []
    for expected, step in enumerate(found):
        if step != expected:
            raise ValueError(f"{step_file(folder, expected)} is missing, though {step_file(folder, step).name} is "
                             "there: put it back, or remove those after it to have these steps solved again")
        if step >= head.steps:
            raise ValueError(f"{step_file(folder, step)} is no step of this path, which has {head.steps}: remove it")
        results.append(_read_step(step_file(folder, step), step, head, results))
    return head, tuple(results)


def _read_head(folder: Path) -> PathHead:
    file = folder / HEAD
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise ValueError(f"{file} is damaged: it has {file.stat().st_size} bytes")
        text = file.read_bytes()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ValueError(f"{folder} holds no load path: there is no {HEAD}") from error
    except IsADirectoryError as error:
        raise ValueError(f"{file} is damaged: it is a folder") from error
    try:
        said = checks.instance("its text", json.loads(text), dict, "an object")
        if said["format"] == _FORMAT:
            factors = {name: check_arrays.vector(f"factors[{name!r}]", values, checks.integer("steps", said["steps"]))
                       for name, values in checks.instance("factors", said["factors"], dict).items()}
            head = PathHead(factors, checks.integer("steps", said["steps"], maximum=_MOST_STEPS),
                            checks.instance("fingerprint", said["fingerprint"], dict), tuple(said["norms"]))
            if head.key == said["key"]:
                return head
            raise ValueError("its key does not fit what it says")
    except DAMAGES as error:
        said = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error or type(error).__name__
        raise ValueError(f"{file} is damaged: {said}") from error
    raise ValueError(f"{folder} was saved by another version of adaptmg; solve again")


def _read_step(file: Path, step: int, head: PathHead, before: list[Result]) -> Result:
    try:
        result, part_of = loaded(file)
    except ValueError as error:
        raise ValueError(f"{error}: {_AGAIN}") from error
    if part_of.get("key") != head.key:
        raise ValueError(f"{file} belongs to another load path than {HEAD} beside it: {_AGAIN}")
    if part_of.get("step") != step:
        raise ValueError(f"{file} holds step {checks.shown(part_of.get('step'))}, not step {step}: put the files back "
                         f"in order, or {_AGAIN}")
    if before and result.displacement.shape != before[0].displacement.shape:
        raise ValueError(f"{file} has {result.displacement.shape} displacements, the first step "
                         f"{before[0].displacement.shape}: {_AGAIN}")
    return replace(result, mesh=before[0].mesh) if before else result
