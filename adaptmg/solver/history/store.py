"""PathStore: the finished steps of a load path in a folder, so that a run that was killed goes on where it was.

A step is written beside its place and renamed: what is there is whole. The fingerprint says what the steps belong to.
Of every array on the meshes it keeps length, norm and the product with a fixed wave, which are compared to a relative
1e-8: another mesh, material, load or law shows, the rounding of another machine does not. The solver is compared by
value, with the code of the user's functions and classes in it (:func:`adaptmg.runtime.fingerprint.value_parts`).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptmg.discretisation.load_steps import LoadSteps
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.runtime.atomic import make_folder
from adaptmg.runtime.fingerprint import value_parts
from adaptmg.solver.history import files
from adaptmg.solver.result import Result

__all__ = ["PathStore", "differences", "fingerprint"]

_TOLERANCE = 1e-8


class PathStore:
    """A folder with the finished steps.

    Parameters
    ----------
    folder : path
        Made where missing.
    factors : mapping of str to (n_steps,) array
    steps : int
        Of the whole path.
    mark : mapping
        The fingerprint.

    Attributes
    ----------
    results : list of Result
        Steps that were there already.

    Raises
    ------
    ValueError
        If the folder holds steps of something else; the message says what differs.
    """

    def __init__(self, folder: str | os.PathLike[str], factors: Mapping[str, np.ndarray], steps: int,
                 mark: Mapping[str, Any]) -> None:
        self.folder = checks.file_path("store", folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"store must be a folder, {self.folder} is a file")
        make_folder("store", self.folder)
        self.results: list[Result] = []
        self._head = files.PathHead(factors, steps, mark)
        if not any(self.folder.glob("step_*.npz")) and not (self.folder / files.HEAD).exists():
            files.write_head(self.folder, self._head)
            return
        # the head that is there stays: steps go by its key
        self._head, results = files.read(self.folder)
        if not self._head.fingerprint:
            raise ValueError(f"{self.folder} was written by PathResult.save, which does not know what it was "
                             "solved for: give another folder as store")
        # as it comes back from JSON
        different = differences(self._head.fingerprint, json.loads(json.dumps(mark)))
        if different:
            raise ValueError(f"the store {self.folder} belongs to another run: {', '.join(different)} differ"
                             f"{'s' if len(different) == 1 else ''}; give another folder, or remove this one")
        self.results = list(results)

    def put(self, step: int, result: Result) -> None:
        """Keep a finished step."""
        files.write_step(self.folder, self._head, step, result)


def fingerprint(grids: Hierarchy, loads: Sequence[LoadSteps | None], factors: Mapping[str, np.ndarray], steps: int,
                parts: Mapping[str, Any], start: np.ndarray | None = None, depends: Mapping[str, Any] | None = None
                ) -> dict[str, Any]:
    """What the steps of a path depend on, as plain values by what a message calls it.

    Parameters
    ----------
    grids : Hierarchy
    loads, factors, steps
        Of each level; of the path.
    parts : mapping
        By name: solver, indicator, ...; compared by value.
    start : array, optional
    depends : mapping, optional
        See :func:`adaptmg.solve_path`.

    Raises
    ------
    TypeError
        If a part cannot be compared by value, and ``depends`` does not name it.
    """
    given = checks.instance("depends", {} if depends is None else depends, Mapping, "a mapping of names to values")
    finest, contact = grids.finest.discrete, grids.finest.discrete.contact
    coordinates = [] if finest.coordinates is None else [_sums(finest.coordinates)]
    return {
        "problem": grids.problem.name if grids.problem is not None else "",
        "grids": [[level.n_nodes, *_sums(level.matrix.data)] for level in grids.levels] + coordinates,
        "transfers": [_sums(level.prolongation.data) for level in grids.levels[1:]],
        "loads": [{name: _sums(load) for name, load in part.loads.items()} for part in loads if part is not None],
        "supports": {name: [*_sums(dofs), *_sums(values)] for name, (dofs, values) in loads[-1].prescribed.items()},
        "contact": [_sums(part) for part in (contact.nodes, contact.normals, contact.gaps, contact.weights)],
        "law": [_sums(part) for part in finest.law.bounds(len(contact))],
        "path": {"steps": steps} | {name: list(map(float, values)) for name, values in factors.items()},
        "start": None if start is None else _sums(start),
    } | value_parts(parts, given)


def _sums(values: np.ndarray) -> list[float]:
    """Length, norm, and product with a wave."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    # not through BLAS, whose sums depend on the number of threads
    return [float(flat.size), float(np.sqrt(np.einsum("i,i->", flat, flat))),
            float(np.einsum("i,i->", flat, np.cos(np.arange(flat.size))))]


def differences(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Names under which two fingerprints differ, numbers by more than rounding."""
    return [name for name in {**wanted, **stored} if not _same(stored.get(name, ...), wanted.get(name, ...))]


def _same(a: Any, b: Any) -> bool:
    """Whether nested plain values agree, numbers to rounding."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[name], b[name]) for name in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return math.isclose(a, b, rel_tol=_TOLERANCE)
    return a == b
