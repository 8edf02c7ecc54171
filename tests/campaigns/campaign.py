"""What the campaigns share: seeds from the command line, one row a seed, computed by several
processes, as CSV."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

# one thread a process, children too
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pandas as pd


def main(
    measure: Callable[[int], dict], summary: Callable[[pd.DataFrame], pd.DataFrame], seeds: range
) -> None:
    """Measure all seeds and print the summary; exit code 1 if a row has faults."""
    name = Path(sys.argv[0]).stem
    parser = argparse.ArgumentParser(
        description=(sys.modules["__main__"].__doc__ or "").split("\n")[0]
    )
    parser.add_argument(
        "--first", type=int, default=seeds.start, metavar="SEED", help="default: %(default)s"
    )
    parser.add_argument(
        "--count", type=int, default=len(seeds), metavar="N", help="default: %(default)s"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results"), metavar="DIR", help="default: results"
    )
    asked = parser.parse_args()
    chosen = range(asked.first, asked.first + asked.count)
    rows = []
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for seed, row in zip(chosen, pool.map(measure, chosen), strict=True):
            rows.append({"seed": seed} | row)
            print(
                f"seed {seed}: {row.get('faults') or row.get('why') or 'sound'}",
                file=sys.stderr,
                flush=True,
            )
    table = pd.DataFrame(rows)
    asked.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(asked.out / f"{name}.csv", index=False)
    print(summary(table).to_string(index=False, float_format="%.3g"))
    faulty = table[table["faults"].fillna("") != ""]
    print(f"{len(table)} seeds, {len(faulty)} with faults; every row: {asked.out / f'{name}.csv'}")
    raise SystemExit(1 if len(faulty) else 0)
