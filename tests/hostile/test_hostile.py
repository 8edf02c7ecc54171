"""Every row of every table is refused with an error that names what is wrong; none crashes, hangs or writes."""

from __future__ import annotations

import importlib
import json
import os
import queue
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hostile_table import TABLES

HERE = Path(__file__).parent
#: seconds that one row may take, the start of its process and its imports included
LIMIT_S = 120
ROWS = [(table, row) for table in TABLES for row in importlib.import_module(table).INPUTS]


def _batch(table: str) -> dict[str, dict]:
    """Outcomes of all rows of a table; after a row that ends or hangs its process the rest goes on in a new one."""
    left = [row.name for row in importlib.import_module(table).INPUTS]
    found: dict[str, dict] = {}
    folders = [str(HERE), str(HERE.parent / "helpers"), str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg",
                   "PYTHONPATH": os.pathsep.join(folders)}
    while left:
        with subprocess.Popen([sys.executable, str(HERE / "child.py"), table, *left], stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True, env=environment) as child:
            lines: queue.Queue[str | None] = queue.Queue()
            threading.Thread(target=_read, args=(child.stdout, lines), daemon=True).start()
            current = left[0]
            while True:
                try:
                    line = lines.get(timeout=LIMIT_S)
                except queue.Empty:
                    child.kill()
                    found[current] = {"raised": "hang", "wanted": False, "text": f"no end in {LIMIT_S} s", "left": []}
                    break
                if line is None:
                    if left and current not in found:
                        found[current] = {"raised": "crash", "wanted": False, "left": [],
                                          "text": f"the process ended with {child.wait()}"}
                    break
                if not line.startswith("{"):
                    continue  # libraries print
                message = json.loads(line)
                if "starts" in message:
                    current = message["starts"]
                else:
                    found[message["name"]] = message
        left = [name for name in left if name not in found]
    return found


def _read(stream, lines) -> None:
    for line in stream:
        lines.put(line)
    lines.put(None)


@pytest.fixture(scope="session")
def outcomes() -> dict[str, dict[str, dict]]:
    """By table and row."""
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(TABLES, pool.map(_batch, TABLES), strict=True))


@pytest.mark.parametrize(("table", "row"), ROWS, ids=lambda value: getattr(value, "name", value))
def test_refused(outcomes, table, row):
    found = outcomes[table][row.name]
    assert found["raised"], found["text"]
    assert found["wanted"], f"{found['raised']}: {found['text']}"
    assert row.says in found["text"]
    assert not found["left"]


def test_names_are_unique_and_rows_many():
    assert all(len({row.name for row in importlib.import_module(t).INPUTS}) == len(importlib.import_module(t).INPUTS)
               for t in TABLES)
    assert len(ROWS) >= 250
