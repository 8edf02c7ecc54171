"""How a report was made: versions, machine, time."""

from __future__ import annotations

import os
import platform
from datetime import datetime
from pathlib import Path

from adaptmg.solver.result.labels import versions

__all__ = ["machine", "made"]


def machine() -> str:
    """Processor, cores, memory and system in a line."""
    name, memory = platform.processor() or platform.machine(), ""
    try:
        found = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                 if line.startswith("model name")]
        name = found[0] if found else name
        memory = f", {os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB"
    except (OSError, ValueError, AttributeError):
        pass
    return f"{name}, {os.cpu_count()} cores{memory}, {platform.system()} {platform.release()}"


def made() -> dict[str, str]:
    """What is said of every report."""
    packages = {"Python": platform.python_version(), **versions()}
    return {"Written": f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
            "Versions": ", ".join(f"{name} {version}" for name, version in packages.items()), "Machine": machine()}
