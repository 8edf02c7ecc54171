"""A word to the user before numba compiles: the only time a call takes seconds without work to show for it.

Compiled kernels are kept on disk beside the source (``__pycache__``), so this happens once per machine and version.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["notice"]

logger = logging.getLogger(__name__)
_checked: set[int] = set()
_announced = False


def notice(*kernels: Callable[..., Any]) -> None:
    """Log an INFO message, once a process, if the next call of one of ``kernels`` has to be compiled.

    Parameters
    ----------
    kernels : numba dispatchers
        Functions made by ``numba.njit``; plain functions (the JIT is off) need no notice.
    """
    global _announced
    for kernel in kernels:
        if _announced or id(kernel) in _checked:
            continue
        _checked.add(id(kernel))
        if _needs_compiling(kernel):
            _announced = True
            logger.info("compiling kernels (once per machine; cached)")


def _needs_compiling(kernel: Callable[..., Any]) -> bool:
    """Whether a kernel has neither been compiled in this process nor left an index file in its cache directory."""
    if not hasattr(kernel, "py_func") or kernel.signatures:
        return False
    directory = kernel.stats.cache_path
    if directory is None:
        return True
    function = kernel.py_func
    name = f"{Path(function.__code__.co_filename).stem}.{function.__qualname__}"
    return not any(Path(directory).glob(f"{name}-*.nbi"))
