"""Where a module, function or class comes from: the user's own, adaptmg, or an installed package."""

from __future__ import annotations

import importlib.metadata
import os
import sys
import sysconfig
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

__all__ = ["ADAPTMG", "INSTALLED", "OWN", "PACKAGES", "home_name", "is_installed", "kind_of", "version_of"]

OWN, ADAPTMG, INSTALLED = "own", "adaptmg", "installed"
#: on which the results of adaptmg depend, with itself
PACKAGES = ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")


@cache
def _installed_places() -> tuple[str, ...]:
    paths = sysconfig.get_paths()
    places = {os.path.realpath(paths[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places |= {os.path.realpath(path) for path in sys.path if Path(path).name in ("site-packages", "dist-packages")}
    return tuple(place + os.sep for place in places)


def kind_of(module: str | None) -> str:
    """What kind of module has a name; without a file it is installed, but for where the user types."""
    if not module or module in ("__main__", "__mp_main__"):
        return OWN
    if module.split(".")[0] == "adaptmg":
        return ADAPTMG
    if module.split(".")[0] in sys.stdlib_module_names:
        return INSTALLED
    file = getattr(sys.modules.get(module), "__file__", None)
    if not isinstance(file, str):
        found = sys.modules.get(module)
        folders = list(getattr(found, "__path__", ()))
        if folders:  # without __init__
            return INSTALLED if any(is_installed(os.path.join(folder, "")) for folder in folders) else OWN
        # else made by hand, or sent to a worker that lacks the module
        return INSTALLED if module in sys.builtin_module_names else OWN
    return INSTALLED if is_installed(file) or not file.endswith(".py") else OWN


def is_installed(file: str) -> bool:
    """Whether a file lies where packages are installed."""
    return os.path.realpath(file).startswith(_installed_places())


def home_name(thing: Any) -> str:
    """The bare name of the user's module where a function or class stands, the same whether it is run or imported.

    Run as a script it is in ``__main__``, here and, sent by value, on a worker: its code tells the file.
    """
    module = thing.__name__ if isinstance(thing, ModuleType) else getattr(thing, "__module__", None) or ""
    if module != "__main__":
        return module.rpartition(".")[2]
    parts = vars(thing).values() if isinstance(thing, type) else [thing]
    files = [Path(part.__code__.co_filename) for part in parts if isinstance(part, FunctionType)]
    # cells of notebooks have files in name only, a new one each time
    return next((file.stem for file in files if file.suffix == ".py" and "ipykernel" not in str(file)), module)


@cache
def version_of(package: str) -> str:
    """Version of an installed package by the name it is imported under; that of Python for its own."""
    if package in sys.stdlib_module_names:
        return ".".join(map(str, sys.version_info[:3]))
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return str(getattr(sys.modules.get(package), "__version__", "unknown"))
