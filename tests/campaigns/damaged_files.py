"""Damaged mesh files, decks and STEP files: read soundly or refused with their names, no crash, no hang.

Cut off, lines dropped, doubled and swapped, bytes and numbers changed. `python tests/campaigns/damaged_files.py`
"""

from __future__ import annotations

import faulthandler
import sys
import tempfile
from pathlib import Path

import pandas as pd
from campaign import main

sys.path.append(str(Path(__file__).parents[1] / "helpers"))
from damage import outcome

HANG_S = 120.0


def measure(seed: int) -> dict:
    """One damaged file."""
    faulthandler.dump_traceback_later(HANG_S, exit=True)
    with tempfile.TemporaryDirectory() as folder:
        row = outcome(seed, Path(folder))
    faulthandler.cancel_dump_traceback_later()
    return row


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """How many files of each kind were read, and the longest time."""
    rows = table.assign(read=table["why"] == "read").groupby("name", as_index=False)
    return rows.agg(files=("seed", "size"), read=("read", "sum"), seconds=("seconds", "max"))


if __name__ == "__main__":
    main(measure, summary, seeds=range(1000), quick=40)
