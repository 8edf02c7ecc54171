"""What the engine of studies costs: seconds a run of 10 000 trivial runs, and what two workers gain over one.

    python studies/sweep_overhead.py [--quick] [--runs N] [--nodes N]

The first 5 s (start of the processes, first imports) are counted apart. For the gain, solves of the GRECO bar run on
one worker and on two in turns, and the cluster is started, and its kernels are warm, before the clock starts.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import adaptmg as am
from adaptmg.study import Study, local_cluster


def trivial(n: int) -> dict[str, Any]:
    """Nothing."""
    return {"m": n}


def bar(friction: float, divisions: int) -> dict[str, Any]:
    """A solve, its hierarchy included."""
    chain = tuple(divisions // 2**k for k in range(5, -1, -1))
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=chain)
    return {"cycles": am.solve(grids, am.FullMultigrid(), throw=False).cycles}


def overhead(runs: int, workers: int, folder: Path) -> dict[str, float]:
    """Seconds of trivial runs on a cluster of their own, with a store on disk."""
    study = Study(trivial, {"n": range(runs)}, folder / f"trivial-{workers}.sqlite")
    begin = time.perf_counter()
    table = study.run(workers=workers, progress=False)
    seconds = time.perf_counter() - begin
    assert (table["status"] == "done").all()
    return {"runs": runs, "workers": workers, "seconds": seconds, "ms a run beyond 5 s": 1e3 * (seconds - 5.0) / runs,
            "ms a run": 1e3 * seconds / runs}


def gain(runs: int, divisions: int, turns: int) -> dict[str, float]:
    """Ratio of the seconds on one worker to those on two, the best of each over some turns."""
    grid = {"friction": [0.1 + 0.9 * k / runs for k in range(runs)], "divisions": [divisions]}
    best: dict[int, float] = {}
    for _ in range(turns):
        for workers in (1, 2):
            with local_cluster(workers) as client:
                # kernels and imports
                Study(bar, {"friction": [0.15 + 0.01 * k for k in range(2 * workers)],
                            "divisions": [divisions]}).run(False, scheduler=client)
                begin = time.perf_counter()
                Study(bar, grid).run(False, scheduler=client)
                seconds = time.perf_counter() - begin
            best[workers] = min(best.get(workers, seconds), seconds)
            print(f"  {workers} worker{'s' * (workers > 1)}: {seconds:.2f} s")
    return {"runs": runs, "nodes": (divisions + 1)**2, "one worker s": best[1], "two workers s": best[2],
            "gain": best[1] / best[2]}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer and smaller runs: some 30 s")
    parser.add_argument("--runs", type=int, help="trivial runs (default 10000; quick 300)")
    parser.add_argument("--turns", type=int, default=2, help="of one worker and two")
    arguments = parser.parse_args()
    load = f", load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores" if hasattr(os, "getloadavg") else ""
    print(f"overhead of trivial runs{load}")
    with tempfile.TemporaryDirectory() as folder:
        for workers in (1, 2):
            found = overhead(arguments.runs or (300 if arguments.quick else 10_000), workers, Path(folder))
            print("  " + ", ".join(f"{name} {value:.4g}" for name, value in found.items()))
    print("gain of two workers")
    found = gain(*((8, 64) if arguments.quick else (64, 128)), 1 if arguments.quick else arguments.turns)
    print("  " + ", ".join(f"{name} {value:.4g}" for name, value in found.items()))


if __name__ == "__main__":
    main()
