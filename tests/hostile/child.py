"""Runs the rows named on the command line, a JSON line each: python child.py TABLE/ROW ..."""

import importlib
import json
import os
import sys
import tempfile
from pathlib import Path


def outcome(row) -> dict[str, object]:
    """What a row did: the exception, whether it is the expected one, and the files that remain."""
    report: dict[str, object] = {"raised": "", "expected": False, "text": "nothing was raised"}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            row.run()
        except BaseException as error:  # the parent judges it
            report = {"raised": type(error).__name__, "expected": isinstance(error, row.error),
                      "text": str(error).encode("utf-8", "backslashreplace").decode()[:2000]}
        report["files"] = [] if row.writes else sorted(str(p.relative_to(folder)) for p in Path(folder).rglob("*"))
        os.chdir("/")
    return report


if __name__ == "__main__":
    for line in sys.argv[1:]:
        table, name = line.split("/", 1)
        rows = {row.name: row for row in importlib.import_module(table).INPUTS}
        print(json.dumps({"starts": line}), flush=True)
        print(json.dumps({"name": line, **outcome(rows[name])}), flush=True)
