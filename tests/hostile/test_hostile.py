"""Every row of every table is refused with an error that names what is wrong; none crashes, hangs or writes."""

import importlib
import os
import tempfile
from multiprocessing import get_context
from pathlib import Path

import pytest
from hostile_table import TABLES

#: seconds that one row may take, the start of its process and its imports included
LIMIT_S = 120
ROWS = {f"{table}/{row.name}": row for table in TABLES for row in importlib.import_module(table).INPUTS}


def fault(row) -> str:
    """What is wrong with the outcome of a row, in an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            row.run()
            wrong = "nothing was raised"
        except BaseException as error:
            sound = isinstance(error, row.error) and row.says in str(error)
            wrong = "" if sound else ascii(f"{type(error).__name__}: {error}")
        left = [] if row.writes else [str(p.relative_to(folder)) for p in Path(folder).rglob("*")]
        os.chdir("/")
    return f"{wrong}, files {left}" if wrong or left else ""


def answer(pipe) -> None:
    while name := pipe.recv():
        pipe.send(fault(ROWS[name]))


@pytest.mark.parametrize("apart", [True, False], ids=["domains", "all others"])
def test_every_row_is_refused(apart, monkeypatch):
    """Domains, for which the limits of Netgen are changed, have a process of their own."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    faults, child, context = {}, None, get_context("spawn")
    for name in (row for row in ROWS if row.startswith("domains/") is apart):
        if child is None:  # also after a row that ended or hung its process
            pipe, other = context.Pipe()
            child = context.Process(target=answer, args=(other,))
            child.start()
            other.close()
        try:
            pipe.send(name)
            faults[name] = pipe.recv() if pipe.poll(LIMIT_S) else f"no end in {LIMIT_S} s"
        except (EOFError, OSError):
            child.join()
            faults[name] = f"the process ended with {child.exitcode}"
        if faults[name]:
            child.kill()
            child = None
    if child is not None:
        pipe.send("")
        child.join()
    assert faults and not any(faults.values()), "\n".join(f"{name}: {text}" for name, text in faults.items() if text)


def test_names_are_unique():
    assert len(ROWS) == sum(len(importlib.import_module(table).INPUTS) for table in TABLES)
