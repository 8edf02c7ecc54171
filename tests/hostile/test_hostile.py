"""Every row of every table is refused with an error that names what is wrong; none crashes, hangs or writes."""

import importlib
import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hostile_table import TABLES

HERE = Path(__file__).parent
#: seconds that one row may take, the start of its process and its imports included
LIMIT_S = 120
ROWS = {f"{table}/{row.name}": row for table in TABLES for row in importlib.import_module(table).INPUTS}


def outcomes_of(open_rows: list[str]) -> dict[str, dict]:
    """Outcomes of rows in a child; after a row that ends or hangs its process the rest continues in a new one."""
    outcomes = {}
    folders = [str(HERE), str(HERE.parent / "helpers"), str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg",
                   "PYTHONPATH": os.pathsep.join(folders)}
    while open_rows:
        current = open_rows[0]
        with subprocess.Popen([sys.executable, str(HERE / "child.py"), *open_rows], stdout=subprocess.PIPE,
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


@pytest.mark.parametrize("apart", [True, False], ids=["domains", "all others"])
def test_every_row_is_refused(apart):
    """Domains, for which the limits of Netgen are changed, have a process of their own."""
    found = outcomes_of([row for row in ROWS if row.startswith("domains/") is apart])
    wrong = {name: f"{one['raised'] or 'nothing'}: {one['text']}, files {one['files']}" for name, one in found.items()
             if not (one["raised"] and one["expected"] and ROWS[name].says in one["text"]) or one["files"]}
    assert found and not wrong, "\n".join(f"{name}: {text}" for name, text in wrong.items())


def test_names_are_unique():
    assert len(ROWS) == sum(len(importlib.import_module(table).INPUTS) for table in TABLES)
