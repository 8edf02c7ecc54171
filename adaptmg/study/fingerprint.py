"""What makes a stored result stale: the source of the run function, the source of adaptmg, versions of packages.

The hash covers the text of the run function, of the script it stands in and of the modules beside that script which it
uses, and of every module of adaptmg that computes (pictures, reports, the command line and this layer are left out).
It does not see what is not source text (closures, data files, other packages): after changing those, run the study with
``rerun=True``.
"""

from __future__ import annotations

import hashlib
import inspect
import platform
import sys
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

__all__ = ["code_hash", "environment"]

#: parts of the package on which no number depends
_NOT_COMPUTING = ("study", "plot", "export", "cli", "__main__.py")


def code_hash(function: Callable[..., Any]) -> str:
    """Hash of the source of ``function``, its script, and the modules of adaptmg that compute.

    Parameters
    ----------
    function : function
        A plain function; where its source is not to be had (typed at a prompt) its bytecode is taken.

    Raises
    ------
    TypeError
        For other callables, whose source does not say what they compute.
    """
    if not isinstance(function, FunctionType):
        raise TypeError(f"run must be a plain function (def), got {function!r}; give constants with fixed={{...}}")
    try:
        own = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        code = function.__code__
        own = repr((code.co_code, code.co_consts, code.co_names))
    return hashlib.sha256((own + _script_text(function) + _package_hash()).encode()).hexdigest()


def _script_text(function: FunctionType) -> str:
    """Text of the file of ``function`` and of the modules in its folder from which that file takes names."""
    first = sys.modules.get(function.__module__)
    home = _file_of(first)
    found: dict[Path, str] = {}
    waiting = [first]
    while waiting:
        module = waiting.pop()
        file = _file_of(module)
        if file is None or file.parent != home.parent or file in found:
            continue
        found[file] = file.read_text(encoding="utf-8", errors="replace")
        for value in list(vars(module).values()):
            waiting.append(value if isinstance(value, ModuleType)
                           else sys.modules.get(getattr(value, "__module__", None) or ""))
    return "\0".join(found[file] for file in sorted(found))


def _file_of(module: ModuleType | None) -> Path | None:
    """The source file of a module, if it has one."""
    name = getattr(module, "__file__", None)
    file = Path(name) if isinstance(name, str) else None
    return file if file is not None and file.suffix == ".py" and file.is_file() else None


@cache
def _package_hash() -> str:
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        relative = file.relative_to(root)
        if relative.parts[0] not in _NOT_COMPUTING:
            digest.update(relative.as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def environment() -> dict[str, str]:
    """Versions of Python and of the packages the results depend on."""
    from adaptmg.solver.result.labels import versions

    return {"python": platform.python_version(), **versions()}
