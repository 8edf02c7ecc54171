"""A study of GRECO solves that is killed at random moments and resumed, compared with a run in one process."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

__all__ = ["campaign"]

SCRIPT = """
import sys
import adaptmg as am
from adaptmg.study import Study

def run(friction, divisions):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(4, 8, 16, divisions))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    return {"cycles": result.cycles, "work_units": result.work_units, "residual": result.residual,
            "u": result.displacement, "top": float(abs(result.displacement).max())}

count = int(sys.argv[2])
study = Study(run, {"friction": [0.1 + 0.05 * k for k in range(count // 2)], "divisions": [32, 64]}, sys.argv[1])
study.run(workers=int(sys.argv[3]) or None, progress=False)
"""


def campaign(runs: int, kills: int, seed: int = 0, longest_s: float = 12.0) -> dict[str, object]:
    """Kill main process, a worker, or all, in turn, at random moments; then finish, and compare with a serial run."""
    from adaptmg.study.store import Store

    chance = random.Random(seed)
    kills_by_kind = {"main": 0, "worker": 0, "all": 0}
    with tempfile.TemporaryDirectory() as folder:
        script, path = Path(folder, "script.py"), Path(folder, "killed.sqlite")
        script.write_text(SCRIPT, encoding="utf-8")
        left: list[psutil.Process] = []
        for k in range(kills):
            process = _started(script, path, runs, 2)
            time.sleep(chance.uniform(0.5, longest_s))
            kind = ("main", "worker", "all")[k % 3]
            children = _children(process)
            if process.poll() is not None:
                path.unlink()  # all was done: begin again
                continue
            kills_by_kind[kind] += _kill(kind, process, children, chance)
            if kind == "worker":
                time.sleep(chance.uniform(0.5, 4.0))
                children += _children(process)
                process.kill()
            process.wait()
            left += psutil.wait_procs(children, timeout=10)[1]
        assert _started(script, path, runs, 2).wait() == 0
        assert _started(script, Path(folder, "serial.sqlite"), runs, 0).wait() == 0
        found, wanted = Store(path).get("run"), Store(Path(folder, "serial.sqlite")).get("run")
        bits = [_bits(Path(folder, f"{name}.sqlite.files"), records)
                for name, records in (("killed", found), ("serial", wanted))]
        return {"kills": kills_by_kind, "done": sum(r.status == "done" for r in found.values()),
                "different": sum(bits[0].get(key) != bits[1][key] for key in bits[1]),
                "left": [p.pid for p in left], "most": max(r.tries for r in found.values())}


def _started(script: Path, path: Path, runs: int, workers: int) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, str(script), str(path), str(runs), str(workers)],
                            stderr=subprocess.DEVNULL, start_new_session=True)


def _children(process: subprocess.Popen) -> list[psutil.Process]:
    with contextlib.suppress(psutil.NoSuchProcess):
        return psutil.Process(process.pid).children(recursive=True)
    return []


def _kill(kind: str, process: subprocess.Popen, children: list[psutil.Process], chance: random.Random) -> int:
    """How many were killed: 0 or 1."""
    if kind == "all":
        os.killpg(process.pid, signal.SIGKILL)
    elif kind == "main":
        process.kill()
    elif children:
        with contextlib.suppress(psutil.NoSuchProcess):
            chance.choice(children).kill()
    return int(kind != "worker" or bool(children))


def _bits(folder: Path, records: dict) -> dict[str, bytes]:
    """What a run gave, to the last bit."""
    return {key: repr(sorted((name, value) for name, value in record.results.items() if name != "u")).encode()
            + np.load(folder / record.files["u"]).tobytes() for key, record in records.items()}


if __name__ == "__main__":
    sys.stdout.write(f"{campaign(*map(int, sys.argv[1:]))}\n")
