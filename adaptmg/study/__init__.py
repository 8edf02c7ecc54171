"""Parameter sweeps: a function and points of its parameters, a durable store, a table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adaptmg._lazy import lazily

if TYPE_CHECKING:
    from adaptmg.study.cluster import local_cluster
    from adaptmg.study.designs import Grid, LatinHypercube, Points, Random, Repeated, Sobol, Zip
    from adaptmg.study.record import StudyStatus
    from adaptmg.study.study import Study
    from adaptmg.study.tables import as_text

__all__ = ["Grid", "LatinHypercube", "Points", "Random", "Repeated", "Sobol", "Study", "StudyStatus", "Zip",
           "as_text", "local_cluster"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = lazily(__name__, {
        "cluster": "local_cluster", "designs": "Grid LatinHypercube Points Random Repeated Sobol Zip",
        "record": "StudyStatus", "study": "Study", "tables": "as_text"})
