"""``adaptmg study``: the study of a Python script, its runs before they are computed, and its rows as JSON."""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
from pathlib import Path

from adaptmg import _checks as checks
from adaptmg.cli.output import printed, rows
from adaptmg.study import Study

#: points that a plan shows
_SHOWN = 20


def study_of(path: Path, store: Path | None) -> Study:
    """Import a script, and return the study that it makes, or that of its ``run`` and ``parameters`` (with ``fixed``
    and ``depends`` where it has them), which is stored in results/SCRIPT.sqlite. What stands below
    ``if __name__ == "__main__"`` does not run."""
    import cloudpickle

    file = checks.file_path("FILE", path)
    if file.suffix != ".py" or not file.is_file():
        raise ValueError(f"FILE must be a Python script that makes an am.Study, got {checks.shown(os.fspath(path))}")
    # as Python does for a script, so that it finds its neighbours; workers get it by value
    sys.path.insert(0, os.fspath(file.resolve().parent))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = sys.modules[file.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    cloudpickle.register_pickle_by_value(module)
    found = list({id(value): value for value in vars(module).values() if isinstance(value, Study)}.values())
    if len(found) == 1:
        if store is not None:
            raise ValueError("--store belongs to scripts with run and parameters: this one makes its am.Study itself")
        return found[0]
    run, parameters = getattr(module, "run", None), getattr(module, "parameters", None)
    if found or run is None or parameters is None:
        raise ValueError(f"{file} must make one am.Study, or have run and parameters; it makes {len(found)} studies")
    return Study(run, parameters, Path("results", f"{file.stem}.sqlite") if store is None else store, name=file.stem,
                 fixed=getattr(module, "fixed", None), depends=getattr(module, "depends", None))


def plan(study: Study) -> str:
    """Return the first points of a study, their status, and the number of points."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
    shown["status"] = list(study.table()["status"].head(_SHOWN))
    rest = len(study) - _SHOWN
    return "\n".join([printed(shown, study.parameters, units={}, note=f"... {rest} more" if rest > 0 else ""), "",
                      repr(study), repr(study.status())])


def summary(study: Study, with_rows: bool) -> dict[str, object]:
    """Return a study as JSON takes it."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})
