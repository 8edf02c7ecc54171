"""Which adaptmg and which packages a process has, so that workers compute what this process would."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from functools import cache
from pathlib import Path

__all__ = ["differences", "identity"]

_PACKAGES = ("ngsolve", "numpy", "scipy", "numba", "pyamg", "cloudpickle", "dask", "distributed")


@cache
def identity() -> dict[str, str]:
    """Versions, and a hash of the source of adaptmg."""
    import adaptmg

    root = Path(adaptmg.__file__).parent
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return {"python": platform.python_version(), "adaptmg": adaptmg.__version__,
            "source of adaptmg": digest.hexdigest()[:12], **{name: _version(name) for name in _PACKAGES}}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def differences(wanted: dict[str, str], found: dict[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(f"{name} {found.get(name, 'none')} instead of {value}" for name, value in wanted.items()
                     if found.get(name) != value)
