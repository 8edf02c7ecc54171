"""Tables on a terminal that is narrower than they are: in blocks, the parameters at the left of each."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from adaptmg.study.tables import as_text, cells

__all__ = ["printed"]


def printed(table: Mapping[str, Sequence[Any]], parameters: Sequence[str], *, units: Mapping[str, str],
            note: str = "", width: int | None = None) -> str:
    """A table as text, in blocks of columns where it is wider than the terminal.

    Parameters
    ----------
    table : mapping, or pandas.DataFrame
        By columns.
    parameters : sequence of str
        Columns that stand in every block.
    units, note
        As of :func:`adaptmg.study.tables.as_text`.
    width : int, optional
        Characters. Default: those of the terminal; where there is none tables may be as wide as they are.
    """
    if width is None:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 10**9
    headers, columns = cells(table, units, None)
    wide = {name: 2 + max(map(len, (header, *column))) for name, header, column
            in zip(table.keys(), headers, columns, strict=True)}
    head = [name for name in parameters if name in wide]
    if 2 * sum(wide[name] for name in head) > width:
        head = head[:1]
    blocks: list[list[str]] = [[]]
    for name in (name for name in wide if name not in head):
        if blocks[-1] and sum(wide[key] for key in (*head, *blocks[-1], name)) - 2 > width:
            blocks.append([])
        blocks[-1].append(name)
    texts = []
    for block in blocks:
        names = [name for name in wide if name in head or name in block]
        mine = {name: unit for name, unit in units.items() if name in names}
        texts.append(as_text({name: table[name] for name in names}, units=mine,
                             note=note if block is blocks[-1] else ""))
    return "\n\n".join(texts)
