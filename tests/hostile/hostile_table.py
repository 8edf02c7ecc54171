"""The form of the tables of hostile inputs: each row is run in a child process, as it may end the process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["TABLES", "Hostile"]

#: the tables: modules beside this one with a tuple INPUTS of Hostile rows
TABLES = (
    "numbers_and_names",
    "result_files",
    "stores",
    "outputs",
    "command_line",
    "problems",
    "discrete_problems",
    "user_parts",
    "hierarchies_and_solvers",
    "mesh_files",
    "mesh_objects",
    "domains_and_sizes",
    "adaptive_loops",
)


@dataclass(frozen=True)
class Hostile:
    """One input that must be refused with words.

    Parameters
    ----------
    name : str
        Unique in its table.
    run : callable
        Does it, in an empty directory; must raise.
    says : str
        Part of the message: the name of the argument (or of the file) that is wrong.
    error : exception type or tuple of them
        What must be raised.
    writes : bool
        Whether the row itself makes files (its own damaged input, say); otherwise nothing may be left behind.
    """

    name: str
    run: Callable[[], object]
    says: str
    error: type[Exception] | tuple[type[Exception], ...] = (ValueError, TypeError)
    writes: bool = False
