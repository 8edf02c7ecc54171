"""A study of GRECO solves that is killed in the middle and resumed, compared with a run in one
process."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

__all__ = ["campaign"]

SCRIPT = """
import ctypes, os, sys
import adaptmg as am
from adaptmg.study import Study

def run(friction, divisions):
    number = round((friction - 0.1) / 0.025) + divisions // 64
    if number >= int(os.environ["ENDING_RUNS"]):
        ctypes.PyDLL(None).sleep(600)  # keeps Python's lock, as compiled code may
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(4, 8, 16, divisions))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    return {"cycles": result.cycles, "work_units": result.work_units, "residual": result.residual,
            "u": result.displacement, "top": float(abs(result.displacement).max())}

count = int(sys.argv[2])
study = Study(run, {"friction": [0.1 + 0.05 * k for k in range(count // 2)], "divisions": [32, 64]}, sys.argv[1])
study.run(workers=int(sys.argv[3]) or None, progress=False)
"""


def campaign(runs: int, kills: int, seed: int = 0) -> dict[str, object]:
    """Kill a worker and then the main process, or all processes, in turn, each after one more run is
    stored and while others go on; then finish, and compare with a serial run."""
    chance, left = random.Random(seed), []
    with tempfile.TemporaryDirectory() as folder:
        script, killed, serial = (
            Path(folder, name) for name in ("script.py", "killed.sqlite", "serial.sqlite")
        )
        script.write_text(SCRIPT, encoding="utf-8")
        for k in range(kills):
            process = _in_the_middle(script, killed, runs, k)
            time.sleep(chance.uniform(0.0, 0.1))
            children = _children(process)
            if k % 2 == 0:
                workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
                chance.choice(workers).kill()
                time.sleep(chance.uniform(0.0, 1.0))
                children += _children(process)
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            left += psutil.wait_procs(children, timeout=10)[1]
        last = [_started(script, path, runs, n) for path, n in ((killed, 2), (serial, 0))]
        assert [process.wait() for process in last] == [0, 0]
        found, wanted = (_bits(path) for path in (killed, serial))
        return {
            "done": sum(record.status == "done" for record in _records(killed).values()),
            "different": sum(found.get(key) != wanted[key] for key in wanted),
            "left": [p.pid for p in left],
        }


def _started(
    script: Path, path: Path, runs: int, workers: int, ending: int | None = None
) -> subprocess.Popen:
    """Start the study, of which only the first ``ending`` runs end."""
    return subprocess.Popen(
        [sys.executable, str(script), str(path), str(runs), str(workers)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env=os.environ | {"ENDING_RUNS": str(runs if ending is None else ending)},
    )


def _children(process: subprocess.Popen) -> list[psutil.Process]:
    with contextlib.suppress(psutil.NoSuchProcess):
        return psutil.Process(process.pid).children(recursive=True)
    return []


def _in_the_middle(script: Path, path: Path, runs: int, count: int) -> subprocess.Popen:
    """Start the study, and return its process when more than ``count`` runs are stored and others
    go on."""
    process = _started(script, path, runs, 2, ending=count + 1)
    while len(_records(path)) <= count:
        assert process.poll() is None
        time.sleep(0.05)
    return process


def _records(path: Path) -> dict:
    from adaptmg.study.store import Store

    return Store(path).get("run") if path.exists() else {}


def _bits(path: Path) -> dict[str, bytes]:
    """What the runs gave, to the last bit."""
    from adaptmg.study.store import Store

    return {
        key: repr(sorted(record.results.items())).encode()
        + Store(path).kept("run", key)["u"].content
        for key, record in _records(path).items()
    }


if __name__ == "__main__":
    sys.stdout.write(f"{campaign(*map(int, sys.argv[1:]))}\n")
