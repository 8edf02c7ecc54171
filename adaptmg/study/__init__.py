"""Parameter sweeps: a function and points of its parameters, a durable store, a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.study.cluster import local_cluster
    from adaptmg.study.designs import Grid, LatinHypercube, Points, Random, Repeated, Sobol, Zip
    from adaptmg.study.record import StudyStatus
    from adaptmg.study.study import Study
    from adaptmg.study.tables import as_text

_WHERE = {"Study": "adaptmg.study.study", "StudyStatus": "adaptmg.study.record",
          "as_text": "adaptmg.study.tables", "local_cluster": "adaptmg.study.cluster"}
_WHERE |= dict.fromkeys(("Grid", "LatinHypercube", "Points", "Random", "Repeated", "Sobol", "Zip"),
                        "adaptmg.study.designs")

__all__ = ["Grid", "LatinHypercube", "Points", "Random", "Repeated", "Sobol", "Study", "StudyStatus", "Zip",
           "as_text", "local_cluster"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        import importlib

        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'adaptmg.study' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
