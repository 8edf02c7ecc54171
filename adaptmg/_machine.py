"""What systems report in their own ways: memory, processors and limits of processes. Each has a
fallback."""

from __future__ import annotations

import platform
import sys
from contextlib import suppress
from pathlib import Path


def memory() -> float:
    """Return the bytes of the main memory."""
    import psutil

    return float(psutil.virtual_memory().total)


def processor() -> str:
    """Return the name of the processor."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    return platform.processor() or platform.machine()


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
    """Limit the memory of this process, and let it leave no core when it breaks down; nothing on
    Windows."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if hard == resource.RLIM_INFINITY or size < hard:
            with suppress(ValueError, OSError):  # macOS refuses some
                resource.setrlimit(resource.RLIMIT_AS, (int(size), hard))
