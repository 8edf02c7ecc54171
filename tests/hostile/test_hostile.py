"""Every row of every table is refused with an error that names what is wrong, and writes
nothing."""

import importlib

import pytest
from hostile_table import TABLES

ROWS = {
    f"{table}/{row.name}": row for table in TABLES for row in importlib.import_module(table).INPUTS
}


@pytest.mark.parametrize("name", ROWS, ids=ascii)
def test_a_row_is_refused(name, tmp_path, monkeypatch):
    row = ROWS[name]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(row.error) as error:
        row.run()
    assert row.says in str(error.value)
    assert row.writes or not list(tmp_path.iterdir())


def test_names_are_unique():
    assert len(ROWS) == sum(len(importlib.import_module(table).INPUTS) for table in TABLES)
