"""The form of the tables of hostile inputs: a few arguments get all hostile values of their type,
others one or two."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

__all__ = ["TABLES", "Hostile", "each", "labelled", "words"]

#: modules next to this one with a sequence INPUTS of Hostile rows
TABLES = (
    "values",
    "arrays_and_matrices",
    "user_parts",
    "domains",
    "result_files",
    "stores",
    "outputs",
    "command_line",
    "mesh_files",
    "mesh_objects",
    "adaptive_loops",
)


@dataclass(frozen=True)
class Hostile:
    """One input that must be refused: ``run``, in an empty folder, raises ``error`` with ``says``
    in its message."""

    name: str
    run: Callable[[], object]
    says: str
    error: type[Exception] | tuple[type[Exception], ...] = (ValueError, TypeError)
    writes: bool = False  # the row makes files itself; otherwise no file may remain


def each(
    argument: str,
    call: Callable[[object], object],
    values: Mapping[str, object],
    labels: Iterable[str] = (),
    **options: object,
) -> Iterator[Hostile]:
    """A row for each of ``values`` (or those of ``labels``); the last word of ``argument`` is what
    the message says."""
    options = {"says": argument.rsplit(" ", 1)[-1]} | options
    for label in labels or values:
        yield Hostile(f"{argument}: {label}", lambda value=values[label]: call(value), **options)


def labelled(values: Iterable[object]) -> dict[str, object]:
    """Values by a name of their type and their number."""
    return {
        f"{getattr(value, '__name__', type(value).__name__)} {k}": value
        for k, value in enumerate(values)
    }


def words(
    make: Callable[..., object], names: str, /, *values: object, **given: object
) -> Iterator[Hostile]:
    """A row for each value of each of these keyword arguments of ``make``."""
    for name in names.split():
        yield from each(
            f"{make.__name__} {name}",
            lambda v, name=name: make(**given, **{name: v}),
            labelled(values),
        )
