"""The most memory that a process held since a moment, as the system counts it."""

from __future__ import annotations

import sys

__all__ = ["forget_peak", "held_memory", "peak_memory"]


def forget_peak() -> None:
    """Count the peak anew from here, where the system can (Linux); elsewhere it stays that of the process."""
    try:
        with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
            file.write("5")
    except OSError:
        return


def peak_memory() -> int:
    """The peak, bytes; 0 where the system does not say."""
    if (told := _told_by_linux("VmHWM")) is not None:
        return told
    try:
        import resource
    except ImportError:
        return 0
    # Linux counts in units of 1024 bytes, macOS in bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def held_memory() -> int:
    """What the process holds now, bytes; 0 where the system does not say."""
    if (told := _told_by_linux("VmRSS")) is not None:
        return told
    try:
        import psutil
    except ImportError:
        return 0
    return psutil.Process().memory_info().rss


def _told_by_linux(name: str) -> int | None:
    """A line of the status of this process, bytes; None elsewhere."""
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as file:
            for line in file:
                if line.startswith(f"{name}:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None
