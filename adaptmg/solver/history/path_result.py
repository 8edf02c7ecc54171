"""PathResult: what :func:`adaptmg.solve_path` returns, a sequence of Results with the factors of their steps."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from adaptmg.problem import checks
from adaptmg.smoother.state import OPEN, SLIP, STICK
from adaptmg.solver.history import files
from adaptmg.solver.result import Result

if TYPE_CHECKING:
    import pandas

__all__ = ["PathResult"]


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Sequence[Result]):
    """The steps of a load path, in order.

    Attributes
    ----------
    results : tuple of Result
        Of the steps done; where a step did not converge it is the last one.
    factors : dict of str to (n_steps,) array
        Factors of all steps of the path, by the name of the load; "default" where loads have no names.
    fingerprint : dict
        What the path was solved for, see :mod:`adaptmg.solver.history.store`; empty without a store.
    n_steps : int
        Steps of the whole path.
    """

    results: tuple[Result, ...]
    factors: Mapping[str, np.ndarray]
    fingerprint: Mapping[str, Any] = field(default_factory=dict)
    n_steps: int = 0

    @property
    def complete(self) -> bool:
        """Whether all steps of the path were solved to their tolerance."""
        return len(self.results) == self.n_steps and all(result.status.ok for result in self.results)

    def __len__(self) -> int:
        return len(self.results)

    @overload
    def __getitem__(self, index: int) -> Result: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Result, ...]: ...

    def __getitem__(self, index: int | slice) -> Result | tuple[Result, ...]:
        return self.results[index]

    def __iter__(self) -> Iterator[Result]:
        return iter(self.results)

    def __repr__(self) -> str:
        about = f" of {self.results[0].solver_name} for {self.results[0].problem_name}" if self.results else ""
        lines = [f"PathResult{about}: {len(self)} of {self.n_steps} steps",
                 f"{'step':>4} {'status':>9} {'cycles':>6} {'seconds':>8} {'open':>6} {'slip':>6} {'stick':>6}  "
                 "factors"]
        for k, result in enumerate(self.results):
            n = _counts(result)
            factors = ", ".join(f"{name} {values[k]:g}" for name, values in self.factors.items())
            lines.append(f"{k:>4} {result.status.name:>9} {result.cycles:>6} {result.seconds:>8.3g} {n['open']:>6} "
                         f"{n['slip']:>6} {n['stick']:>6}  {factors}")
        return "\n".join(lines)

    def table(self) -> pandas.DataFrame:
        """One row a step.

        Returns
        -------
        pandas.DataFrame
            step; "factor NAME" for each load; status; cycles; work_units; seconds; residual (natural, relative);
            open, slip and stick (contact nodes); force_x, force_y, force_z: resultant of all contact forces on the
            contact boundaries, N (2D: N/m); pressure: the largest contact pressure, Pa; slip_size: the largest slip of
            the step at a node in contact, m.
        """
        import pandas

        rows = []
        for k, result in enumerate(self.results):
            force = result.resultant("contact").force
            c = result.contact
            slips = np.linalg.norm(c.slip, axis=1)[c.state != OPEN]
            rows.append({"step": k} | {f"factor {name}": values[k] for name, values in self.factors.items()}
                        | {"status": result.status.name, "cycles": result.cycles, "work_units": result.work_units,
                           "seconds": result.seconds, "residual": result.residual} | _counts(result)
                        | {f"force_{'xyz'[d]}": float(value) for d, value in enumerate(force)}
                        | {"pressure": float(c.pressure.max()), "slip_size": float(slips.max(initial=0.0))})
        return pandas.DataFrame(rows)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write a file a step, and the factors; the mesh goes into the first.

        Raises
        ------
        ValueError
            If the folder holds another path already.
        """
        files.write(checks.file_path("folder", folder), self.results, self.factors, self.n_steps, self.fingerprint)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> PathResult:
        """Read what :meth:`save` wrote, or the steps that :func:`adaptmg.solve_path` has stored so far.

        Raises
        ------
        ValueError
            If the folder holds no load path, or a file in it is damaged, missing, or of another path or step.
        """
        head, results = files.read(checks.file_path("folder", folder))
        return cls(results, head.factors, head.fingerprint, head.steps)


def _counts(result: Result) -> dict[str, int]:
    """Contact nodes by state."""
    states = np.bincount(np.asarray(result.contact.state, dtype=int), minlength=3)
    return {"open": int(states[OPEN]), "slip": int(states[SLIP]), "stick": int(states[STICK])}
