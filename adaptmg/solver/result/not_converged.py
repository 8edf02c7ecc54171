"""NotConverged: the exception that carries the result."""

from __future__ import annotations

from typing import Any

from adaptmg.solver.result.result import Result

__all__ = ["NotConverged"]


class NotConverged(RuntimeError):
    """Raised by :func:`adaptmg.solve` when the tolerance was not reached.

    Attributes
    ----------
    result : Result
        The last iterate with its true residual.
    """

    def __init__(self, result: Result) -> None:
        self.result = result
        found = () if result.checked is None else result.checked.contradictions(result.rtol)
        contradicted = f" The certificate contradicts this tolerance: {', '.join(found)}." if found else ""
        super().__init__(f"{result.solver_name}: {result.status.name} after {result.cycles} cycles, natural residual "
                         f"{result.residual:.2e}, estimated error {result.error_estimate:.2e}: {result.status.value}."
                         f"{contradicted} The last iterate is in the exception's .result; throw=False returns "
                         "it instead.")

    def __reduce__(self) -> tuple[Any, ...]:
        # exceptions are rebuilt from .args, which is the text here: a process that is handed one back must not fail
        return type(self), (self.result,)
