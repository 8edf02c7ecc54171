"""Options of ``adaptmg study`` that are looked at before a solver is loaded or a store is made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from adaptmg.cli.described.address import check_scheduler
from adaptmg.cli.described.study_file import StudyFile

__all__ = ["check_options"]


def check_options(said: StudyFile, options: Mapping[str, Any]) -> None:
    """ValueError or OSError for options of a run that cannot be, before a store is made."""
    here = options.get("workers") is None and options.get("scheduler") is None
    limits = [key for key in ("limit_s", "memory_limit") if options.get(key) is not None]
    if here and limits:
        raise said.file.wrong(f"run.{limits[0]} needs workers, in the file or as --workers 1 or more: a run in this "
                              "process cannot be stopped", "run", limits[0])
    if options.get("workers") is not None and options.get("scheduler") is not None:
        raise ValueError("give --workers (processes of this machine) or --scheduler (a cluster), not both")
    if options.get("scheduler") is not None:
        check_scheduler(options["scheduler"])
    most = max(64, 4 * (os.cpu_count() or 1))
    if (options.get("workers") or 0) > most:
        raise ValueError(f"workers must be at most {most} on this machine, got {options['workers']}: several machines "
                         "need a scheduler (--scheduler)")
