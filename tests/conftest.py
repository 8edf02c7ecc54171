"""What all tests share: pictures are drawn without a screen, and workers of pytest-xdist end at
about the same time."""

import gc
import os
from collections import Counter
from collections.abc import Generator

if "PYTEST_XDIST_WORKER" in os.environ:  # threads of BLAS would wait for those of other workers
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib
import matplotlib.pyplot as plt
import pytest

matplotlib.use("Agg")


@pytest.fixture(autouse=True, scope="module")
def closed_pictures():
    """Close the pictures of a file: the tests of others check that none is open."""
    yield
    plt.close("all")


def pytest_configure(config: pytest.Config) -> None:
    """Keep the order of :func:`pytest_collection_modifyitems` (pytest-xdist may be absent)."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_sessionstart(session: pytest.Session) -> None:
    """Share the compilation of kernels among the workers, in a clone that has none: nearly all files
    need the same ones, and a worker reads what another one has stored."""
    worker = getattr(session.config, "workerinput", None)
    if worker is not None and not any((session.config.rootpath / "adaptmg").rglob("*.nbi")):
        from adaptmg.cli.warm import STEPS, solve_step

        for name in list(STEPS)[int(worker["workerid"][2:]) :: worker["workercount"]]:
            solve_step(name)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without looking for garbage, and never look among what has been collected: modules and
    tests stay. A quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let workers begin with the files that have slow tests, and end with those of few, quick ones."""
    if hasattr(config, "workerinput"):
        n_tests = Counter(item.path for item in items)
        slow = {item.path for item in items if item.get_closest_marker("slow")}
        items.sort(key=lambda item: (item.path not in slow, -n_tests[item.path]))
