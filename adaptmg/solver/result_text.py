"""How a result prints: its summary, and the message of a solve that did not converge."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from adaptmg.solver.result import Result


def summary(result: Result) -> str:
    """Return the text that printing a result shows."""
    states = result.contact.counts()
    certified = ""
    if result.checked is not None:
        worst = result.checked.worst
        certified = (
            f"\n  certificate: worst {worst.name} {worst.largest:.2e} {worst.unit} (relative "
            f"{worst.relative:.2e}), energy error {result.checked.energy_error:.2e}; "
            f"{result.timings.get('certificate', 0.0):.2g} s"
        )
    return (
        f"Result of {result.method} for {result.problem_name}: {result.status.name}\n"
        f"  {len(result.displacement)} nodes, {len(result.contact)} contact nodes: "
        f"{', '.join(f'{count} {state}' for state, count in states.items())}\n"
        f"  {result.cycles} cycles, {result.work_units:.2f} work units, {result.seconds:.3g} s\n"
        f"  natural residual {result.residual:.2e}, estimated error {result.error_estimate:.2e} "
        f"(rtol {result.rtol:g}){certified}"
        + f"\n  solver=None: {result.choice}" * bool(result.choice)
        + "".join(f"\n  {line}" for line in result.advice)
    )


def failure(result: Result) -> str:
    """Return the message of :class:`adaptmg.NotConverged`."""
    violated = () if result.checked is None else result.checked.contradictions(result.rtol)
    contradicted = (
        f" The certificate contradicts this tolerance: {', '.join(violated)}." if violated else ""
    )
    poisson = 0.0 if result.stress_data is None else result.stress_data.locking
    locked = (
        f'give the problem elements="smoothed", since linear ones lock at a Poisson\'s ratio of '
        f"{poisson:.4g}, where Coulomb's law may have no solution on them; else, "
        if poisson
        else ""
    )
    return (
        f"{result.method}: {result.status.name} after {result.cycles} cycles, natural residual "
        f"{result.residual:.2e}, estimated error {result.error_estimate:.2e}: {locked}"
        f"{result.status.value}.{contradicted} The last iterate is in the exception's .result; throw=False returns "
        "it instead."
    )


def label(option: object) -> str:
    """Return the name of an option object with the fields that differ from their defaults, for
    tables and pictures."""
    if not is_dataclass(option) or isinstance(option, type):
        return repr(option)
    shown = []
    for item in fields(option):
        value = getattr(option, item.name)
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        if item.repr and (default is MISSING or value != default):
            shown.append(f"{item.name}={label(value)}")
    return f"{type(option).__name__}({', '.join(shown)})"
