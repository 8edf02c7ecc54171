"""Kernels as plain Python: their results must not depend on the compiler."""

from types import ModuleType

import pytest

__all__ = ["uncompile"]


def uncompile(monkeypatch: pytest.MonkeyPatch, *modules: ModuleType) -> None:
    """Put the Python function in the place of every compiled one in these modules, imported ones
    included."""
    for module in modules:
        for name, value in vars(module).copy().items():
            if hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, value.py_func)
