"""Parameter sweeps: a function and a grid of parameters, a durable store, a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.study.study import Study
    from adaptmg.study.tables import as_html, as_text

_WHERE = {"Study": "adaptmg.study.study", "as_html": "adaptmg.study.tables", "as_text": "adaptmg.study.tables"}

__all__ = ["Study", "as_html", "as_text"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        import importlib

        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'adaptmg.study' has no attribute {name!r}")
