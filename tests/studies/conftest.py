"""Quick runs of the studies, each computed once."""

from __future__ import annotations

from functools import cache

import pytest
from study_scripts import load


@pytest.fixture(scope="session")
def quick(tmp_path_factory):
    """Figures and tables of a quick run of a study by their names; the tables are written."""
    common = load("common")

    @cache
    def run(name: str, full: bool) -> dict:
        folder = tmp_path_factory.mktemp(name)
        section = load(name).run(common.Context(quick=True, out=folder, full=full))
        common.show(section, folder, pictures=False)
        kinds = [[item for item in section.items if isinstance(item, kind)] for kind in (common.Figure, common.Table)]
        assert section.title and section.summary
        assert all(len({item.name for item in items}) == len(items) for items in kinds)
        assert all((folder / f"{item.name}.csv").stat().st_size > 100 for item in kinds[1])
        return {item.name: item for items in kinds for item in items}

    return lambda name, full=False: run(name, full)


@pytest.fixture(scope="session")
def tables(quick):
    """Frames of the tables of a quick run by their names."""
    return lambda name, full=False: {key: item.frame for key, item in quick(name, full).items()
                                     if hasattr(item, "frame")}
