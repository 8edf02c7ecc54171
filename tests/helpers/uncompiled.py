"""Kernels as plain Python: their results must not depend on the compiler."""

from types import ModuleType

import pytest

__all__ = ["uncompile"]

#: what compiled code asks of the processor, and Python need not
HINTS = {"prefetch": lambda address: None}


def uncompile(monkeypatch: pytest.MonkeyPatch, *modules: ModuleType) -> None:
    """Put the Python function in the place of every compiled one in these modules, imported ones
    included."""
    for module in modules:
        for name, value in vars(module).copy().items():
            plain = getattr(value, "py_func", HINTS.get(name))
            if plain is not None:
                monkeypatch.setattr(module, name, plain)
