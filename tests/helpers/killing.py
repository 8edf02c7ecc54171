"""A study that is killed in the middle and resumed, compared with what its runs compute."""

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

from adaptmg.study.store import Store, pack

__all__ = ["campaign"]

SCRIPT = """
import ctypes, os, sys
import numpy as np
from adaptmg.study import Study

def run(number):
    if number >= int(os.environ["ENDING_RUNS"]):
        ctypes.PyDLL(None).sleep(600)  # keeps Python's lock, as compiled code may
    u = np.random.default_rng(number).normal(size=100)
    return {"u": u, "top": float(u.max())}

Study(run, {"number": range(int(sys.argv[2]))}, sys.argv[1]).run(workers=2, progress=False)
"""


def campaign(runs: int, kills: int, seed: int = 0) -> dict[str, object]:
    """Kill a worker and then the main process, or all processes, in turn, each after one more run is
    stored and while others go on; then finish."""
    chance, left = random.Random(seed), []
    with tempfile.TemporaryDirectory() as folder:
        script, path = Path(folder, "script.py"), Path(folder, "killed.sqlite")
        script.write_text(SCRIPT, encoding="utf-8")
        for k in range(kills):
            process = _in_the_middle(script, path, runs, k)
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
        assert _started(script, path, runs, ending=runs).wait() == 0
        return {
            "done": sum(record.status == "done" for record in _records(path).values()),
            "different": sum(_differs(path, *item) for item in _records(path).items()),
            "left": [p.pid for p in left],
        }


def _started(script: Path, path: Path, runs: int, ending: int) -> subprocess.Popen:
    """Start the study, of which only the first ``ending`` runs end."""
    return subprocess.Popen(
        [sys.executable, str(script), str(path), str(runs)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env=os.environ | {"ENDING_RUNS": str(ending)},
    )


def _children(process: subprocess.Popen) -> list[psutil.Process]:
    with contextlib.suppress(psutil.NoSuchProcess):
        return psutil.Process(process.pid).children(recursive=True)
    return []


def _in_the_middle(script: Path, path: Path, runs: int, count: int) -> subprocess.Popen:
    """Start the study, and return its process when more than ``count`` runs are stored and others
    go on."""
    process = _started(script, path, runs, ending=count + 1)
    while len(_records(path)) <= count:
        assert process.poll() is None
        time.sleep(0.05)
    return process


def _records(path: Path) -> dict:
    return Store(path).get("run") if path.exists() else {}


def _differs(path: Path, key: str, record) -> bool:
    """Whether a run did not give its numbers, to the last bit."""
    u = np.random.default_rng(record.parameters["number"]).normal(size=100)
    kept = Store(path).kept("run", key)
    return kept != {"u": pack(u)} or record.results["top"] != float(u.max())


if __name__ == "__main__":
    sys.stdout.write(f"{campaign(*map(int, sys.argv[1:]))}\n")
