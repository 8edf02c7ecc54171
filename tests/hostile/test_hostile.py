"""Every row of every table is refused with an error that names what is wrong; none crashes, hangs or writes."""

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
ROWS = {table: {row.name: row for row in importlib.import_module(table).INPUTS} for table in TABLES}


def _batch(table: str) -> dict[str, dict]:
    """Outcomes of all rows of a table; after a row that ends or hangs its process the rest continues in a new one."""
    open_rows, outcomes = list(ROWS[table]), {}
    folders = [str(HERE), str(HERE.parent / "helpers"), str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg",
                   "PYTHONPATH": os.pathsep.join(folders)}
    while open_rows:
        current = open_rows[0]
        with subprocess.Popen([sys.executable, str(HERE / "child.py"), table, *open_rows], stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True, env=environment) as child:
            lines: queue.Queue[str | None] = queue.Queue()
            threading.Thread(target=_read, args=(child.stdout, lines), daemon=True).start()
            try:
                while (line := lines.get(timeout=LIMIT_S)) is not None:
                    if not line.startswith("{"):
                        continue  # libraries print
                    message = json.loads(line)
                    current = message.get("starts", current)
                    if "name" in message:
                        outcomes[message["name"]] = message
                end = {"raised": "crash", "text": f"the process ended with {child.wait()}"}
            except queue.Empty:
                child.kill()
                end = {"raised": "hang", "text": f"no end in {LIMIT_S} s"}
        outcomes.setdefault(current, {**end, "expected": False, "files": []})
        open_rows = [name for name in open_rows if name not in outcomes]
    return outcomes


def _read(stream, lines) -> None:
    for line in stream:
        lines.put(line)
    lines.put(None)


@pytest.fixture(scope="session")
def outcomes() -> dict[str, dict[str, dict]]:
    """By table and row."""
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(TABLES, pool.map(_batch, TABLES), strict=True))


@pytest.mark.parametrize(("table", "name"), [(table, name) for table, rows in ROWS.items() for name in rows])
def test_refused(outcomes, table, name):
    outcome = outcomes[table][name]
    assert outcome["raised"], outcome["text"]
    assert outcome["expected"], f"{outcome['raised']}: {outcome['text']}"
    assert ROWS[table][name].says in outcome["text"] and not outcome["files"]


def test_names_are_unique():
    for table, rows in ROWS.items():
        assert len(rows) == len(importlib.import_module(table).INPUTS)
