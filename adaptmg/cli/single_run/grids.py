"""Grids of a run: uniform, independent, or bisected at contact; what cannot be meshed is refused before."""

from __future__ import annotations

from typing import Any

import numpy as np

import adaptmg as am
from adaptmg.cli.choices import TransferName
from adaptmg.cli.single_run.settings import Settings, section
from adaptmg.problem import checks

__all__ = ["check_grids", "check_size", "grids"]

_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}
#: nodes of uniform grids that are refused before anything runs
_MOST_NODES = {2: 5e6, 3: 2e6}
#: the same of graded ones, whose domains fill a part of their boxes; elements along contact
_MOST_ROUGHLY, _MOST_ALONG = 10.0, 1e5
#: times that the elements at contact can be bisected
_MOST_BISECTIONS = 30
_TRANSFERS = {TransferName.INTERPOLATION: am.Interpolation, TransferName.L2: am.L2, TransferName.LUMPED: am.LumpedL2,
              TransferName.PSEUDO: am.PseudoL2, TransferName.QUASI: am.QuasiInterpolation}


def check_grids(task: am.ContactProblem, settings: Settings) -> None:
    """ValueError for grids that cannot be made, or that would take hours."""
    given = section(settings, "hierarchy")
    if section(settings, "adapt"):
        if given:
            raise ValueError("give [hierarchy] or [adapt], not both: adaptation makes its own meshes")
        return
    _check_bisections(given)
    if "sizes" not in given:
        _check_divisions(task, given)
        return
    if "divisions" in given:
        raise ValueError("give hierarchy.divisions or hierarchy.sizes, not both")
    check_size(task, "hierarchy.sizes", max(given["sizes"]))
    factors = _factors(given)
    for name in factors:
        if name not in _bodies(task):
            known = ", ".join(filter(None, _bodies(task)))
            raise ValueError(f"hierarchy.size_of.{name}: the case has no such body" + (
                f"{checks.suggestion(name, _bodies(task))}; it has {known}" if known else ", it has one alone"))
    for name, part in _bodies(task).items():
        _check_finest(task.dim, part, min(given["sizes"]) * factors.get(name, 1.0), given.get("contact_ratio", 1.0))


def _check_bisections(given: dict[str, Any]) -> None:
    if "bisections" not in given:
        return
    if given["bisections"] > _MOST_BISECTIONS:
        raise ValueError(f"hierarchy.bisections must be at most {_MOST_BISECTIONS}, got {given['bisections']}")
    if "transfer" in given:
        raise ValueError("hierarchy.transfer belongs to meshes that are not nested; those of hierarchy.bisections are")
    for key in ("divisions", "sizes"):
        if len(given.get(key, (1,))) > 1:
            raise ValueError(f"hierarchy.bisections make the finer grids: give one of hierarchy.{key}, got "
                             f"{len(given[key])}")
    if "divisions" not in given and "sizes" not in given:
        raise ValueError("hierarchy.bisections need a grid to begin with: hierarchy.divisions = [8], or "
                         "hierarchy.sizes = [5e-3]")


def _check_divisions(task: am.ContactProblem, given: dict[str, Any]) -> None:
    if useless := sorted(set(given) - {"divisions", "bisections"}):
        raise ValueError(f"hierarchy.{useless[0]} belongs to hierarchy.sizes (independent, non-nested meshes)")
    parts = _bodies(task).values()
    if not all(isinstance(part, am.Rectangle | am.Box) for part in parts):
        raise ValueError("hierarchy.divisions are for rectangles and boxes, which this case is not: give "
                         "hierarchy.sizes = [10e-3, 5e-3] (element sizes in m, coarse to fine)")
    finest = max(given.get("divisions", (1,)))
    nodes = len(parts) * (finest + 1.0)**task.dim
    if nodes > _MOST_NODES[task.dim]:
        raise ValueError(f"hierarchy.divisions: {finest} cells a side make {nodes:.2g} nodes, at most "
                         f"{_MOST_NODES[task.dim]:.2g} are run in a study: take fewer")


def check_size(task: am.ContactProblem, name: str, size: float) -> None:
    """Most sizes that are too large are in millimetres."""
    longest = max(float((part.upper - part.lower).max()) for part in _bodies(task).values())
    if size > longest:
        raise ValueError(f"{name} = {size:g} m is more than the body is long ({longest:g} m): sizes are in m, such as "
                         f"{longest / 4:g}")


def _check_finest(dim: int, part: Any, size: float, ratio: float) -> None:
    """Sizes of which Netgen would make elements for hours."""
    nodes = float(np.prod((part.upper - part.lower) / size))
    along = float((part.upper - part.lower).max()) / size * ratio
    if nodes > _MOST_ROUGHLY * _MOST_NODES[dim] or along > _MOST_ALONG:
        at_contact = f" ({size / ratio:g} m at contact)" if ratio > 1 else ""
        raise ValueError(f"hierarchy.sizes, down to {size:g} m{at_contact}, make "
                         f"some {max(nodes, along):.0e} nodes: at most {_MOST_NODES[dim]:.0e} are run in a study")


def grids(task: am.ContactProblem, settings: Settings) -> am.Hierarchy:
    """Uniform grids; independent ones where sizes are given; or one of either, bisected at contact."""
    check_grids(task, settings)
    given = section(settings, "hierarchy")
    if "sizes" in given:
        factors = _factors(given)
        sizes = [{name: size * factors.get(name, 1.0) for name in _bodies(task)} if factors else size
                 for size in given["sizes"]]
        made = am.Hierarchy.graded(task, sizes, given.get("contact_ratio", 1.0),
                                   transfer=_TRANSFERS[given.get("transfer", TransferName.INTERPOLATION)]())
    else:
        made = am.Hierarchy.uniform(task, divisions=given.get("divisions", _DIVISIONS[task.dim]))
    if "bisections" in given:
        return am.Hierarchy.bisected(task, made.levels[0].mesh, given["bisections"])
    return made


def _factors(given: dict[str, Any]) -> dict[str, float]:
    """What the sizes of bodies are taken times."""
    return section(given, "size_of")


def _bodies(task: am.ContactProblem) -> dict[str, Any]:
    """Domains by name of body; of one alone the name is empty."""
    return getattr(task.domain, "parts", {"": task.domain})
