"""The points that a store has, as a design."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from adaptmg.study.designs import Points, check_length
from adaptmg.study.record import canonical, restored
from adaptmg.study.store import Store

__all__ = ["stored_design"]


def stored_design(store: Store, study: str, fixed: Mapping[str, Any]) -> Points:
    """The points of a study with these fixed parameters, computed or not; without the fixed ones.

    Raises
    ------
    ValueError
        If there are none.
    """
    keys = dict.fromkeys([*store.get(study), *store.points(study)])
    points = [{name: restored(value) for name, value in json.loads(key).items()} for key in keys]
    texts = {name: canonical({name: value}) for name, value in fixed.items()}
    mine = [{name: value for name, value in point.items() if name not in texts} for point in points
            if all(name in point and canonical({name: point[name]}) == text for name, text in texts.items())]
    check_length(len(mine))
    if not mine:
        raise ValueError(f"the store has no points of a study {study!r} with these fixed parameters: give parameters")
    return Points(mine)
