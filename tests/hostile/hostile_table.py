"""The form of the tables of hostile inputs: each row is run in a child process, as it may end the process.

A table belongs to a type of argument. A few representative arguments get all hostile values of the type, each other
argument of the public API one or two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

__all__ = ["TABLES", "Hostile", "each"]

#: modules next to this one with a sequence INPUTS of Hostile rows
TABLES = ("numbers_and_counts", "arrays_and_matrices", "names_and_objects", "user_parts", "domains", "result_files",
          "stores", "outputs", "command_line", "mesh_files", "mesh_objects", "adaptive_loops")


@dataclass(frozen=True)
class Hostile:
    """One input that must be refused with a message."""

    name: str  # unique in its table
    run: Callable[[], object]  # does it, in an empty directory; must raise
    says: str  # part of the message: the name of the argument (or of the file) that is wrong
    error: type[Exception] | tuple[type[Exception], ...] = (ValueError, TypeError)
    writes: bool = False  # whether the row itself makes files (its own damaged input, say); else none may remain


def each(argument: str, call: Callable[[object], object], values: Mapping[str, object], labels: Iterable[str] = (),
         **options: object) -> Iterator[Hostile]:
    """A row for each of ``values`` (or those of ``labels``); the last word of ``argument`` is what the message says."""
    for label in labels or values:
        says = options.get("says", argument.rsplit(" ", 1)[-1])
        rest = {name: value for name, value in options.items() if name != "says"}
        yield Hostile(f"{argument}: {label}", lambda value=values[label]: call(value), says, **rest)
