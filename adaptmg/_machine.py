"""Memory, processors and limits of processes, which each system reports in another way. Each value
has a fallback."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path


@cache  # every mesh asks for it
def memory() -> float:
    """Return the bytes of the main memory."""
    with suppress(AttributeError, OSError, ValueError):  # not on Windows
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    import psutil  # takes .01 of 1.0 s to a first result

    return float(psutil.virtual_memory().total)


def processors() -> int:
    """Return the number of processors that this process may use."""
    with suppress(AttributeError):  # Linux alone
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def has_idle_processor() -> bool:
    """Return whether fewer threads run now than this process has processors; False where the system
    does not report it."""
    with suppress(OSError):
        running = Path("/proc/loadavg").read_text(encoding="ascii").split()[3].partition("/")[0]
        return int(running) < processors()
    return False


def processor() -> str:
    """Return the name of the processor."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    return platform.processor() or platform.machine()


def process_name(process: int) -> str:
    """Return a name that only this process has among those of all machines and times; "" if there is
    no process of this number. The name does not depend on the clock of the system, which may be set,
    as times of psutil do."""
    machine_name = platform.node()
    start = None
    with suppress(OSError):  # containers number their processes from 1
        machine_name += os.readlink("/proc/self/ns/pid")
    with suppress(OSError, ValueError):
        status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        # the fields after the name of the program, in parentheses: the state, ...
        state, *fields = status.rpartition(")")[2].split()
        is_dead = state in "ZX"
        start = None if is_dead else int(fields[18])  # ticks from the start of the system
    if start is None and not Path("/proc/self/stat").exists():
        import psutil

        with suppress(psutil.Error):
            start = round(psutil.Process(process).create_time())
    machine = hashlib.sha256(machine_name.encode("utf-8", "replace")).hexdigest()[:12]
    return "" if start is None else f"{machine}-{process}-{start}"


def has_ended(name: str) -> bool:
    """Return whether a process of this name has ended; False for those of other machines, of which
    that is not seen."""
    parts = re.fullmatch(r"(\w+)-(\d{1,18})-\d+", name)
    ours = process_name(os.getpid()).partition("-")[0]
    return parts is not None and parts[1] == ours and process_name(int(parts[2])) != name


def reset_peak_memory() -> None:
    """Count the peak of memory from here, where the system allows it."""
    with suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")


def peak_memory() -> int:
    """Return the largest memory of this process in bytes; 0 where the system does not report it."""
    with suppress(OSError, ValueError, IndexError):
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return 1024 * int(status.partition("VmHWM:")[2].split(maxsplit=1)[0])
    return 0


def limit_memory(size: float) -> None:
    """Limit the memory of this process to a finite ``size`` in bytes, and let it leave no core when it
    breaks down; nothing on Windows."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if hard == resource.RLIM_INFINITY or size < hard:
            with suppress(ValueError, OSError):  # macOS refuses some
                resource.setrlimit(resource.RLIMIT_AS, (int(size), hard))
