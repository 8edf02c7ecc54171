"""Build the documentation: HTML pages that open offline, search and formulas included.

    python studies/docs.py [--out DIR]

Sources: docstrings of adaptmg, pages in studies/docs, tutorials in studies/tutorials (scripts, run while building),
tables in data/measured (written by studies). Needs the packages of ``pip install -e ".[docs]"``.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Command line; exit code 1 where Sphinx warns."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0],
                                     epilog="example: python studies/docs.py --out /tmp/docs")
    parser.add_argument("--out", type=Path, default=Path("results/docs"), metavar="DIR", help="default: results/docs")
    out = parser.parse_args().out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        shutil.copytree(ROOT / "studies" / "docs", source)
        shutil.copytree(ROOT / "studies" / "tutorials", source / "tutorials")
        code = subprocess.run([sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", "-b", "html",
                               "-d", str(Path(folder) / "doctrees"), str(source), str(out)], check=False).returncode
    if not code:
        print(f"documentation: {out / 'index.html'}")
    return 1 if code else 0


if __name__ == "__main__":
    raise SystemExit(main())
