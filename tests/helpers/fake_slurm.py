"""An imitation of a queue: sbatch and scancel as scripts that start and end jobs on this
machine."""

import os
import sys
from pathlib import Path

__all__ = ["fake_slurm"]

_SBATCH = """#!{python}
import subprocess, sys
job = subprocess.Popen(["/bin/sh", "-c", "sleep {wait}; PYTHONPATH={path} exec /bin/sh " + sys.argv[-1] + ".kept"],
                       start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
# the file goes when this command ends
open(sys.argv[-1] + ".kept", "w").write(open(sys.argv[-1]).read())
open({jobs!r}, "a").write(f"{{job.pid}}\\n")
print(f"Submitted batch job {{job.pid}}")
"""
_SCANCEL = """#!{python}
import os, signal, sys
for job in sys.argv[1:]:
    try:
        os.killpg(int(job), signal.SIGTERM)
    except ProcessLookupError:
        pass
"""


def fake_slurm(folder: Path, wait_s: float) -> Path:
    """Write the commands into a folder for PATH; jobs wait ``wait_s`` and add their group to the
    returned file."""
    jobs = folder / "jobs"
    for name, text in (("sbatch", _SBATCH), ("scancel", _SCANCEL)):
        file = folder / name
        file.write_text(
            text.format(
                python=sys.executable, wait=wait_s, jobs=str(jobs), path=os.pathsep.join(sys.path)
            ),
            encoding="utf-8",
        )
        file.chmod(0o755)
    return jobs
