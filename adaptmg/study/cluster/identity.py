"""Which adaptmg and which packages a process has, so that workers compute what this process would."""

from __future__ import annotations

import importlib.metadata
import platform
from functools import cache

__all__ = ["differences", "identity"]

_PACKAGES = ("ngsolve", "numpy", "scipy", "numba", "pyamg", "cloudpickle", "dask", "distributed")


@cache
def identity() -> dict[str, str]:
    """Versions; what is in the modules of adaptmg that a run reaches is part of its fingerprint."""
    import adaptmg

    return {"python": platform.python_version(), "adaptmg": adaptmg.__version__,
            **{name: _version(name) for name in _PACKAGES}}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def differences(wanted: dict[str, str], found: dict[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(f"{name} {found.get(name, 'none')} instead of {value}" for name, value in wanted.items()
                     if found.get(name) != value)
