"""Files that cannot be written, and results, names and tables that cannot be written to them."""

import functools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from hostile_table import Hostile, each

import adaptmg as am


@functools.cache
def result() -> am.Result:
    from made import result_on, square

    return result_on(square(2))


def path_result() -> am.PathResult:
    return am.PathResult((result(),), {"left": np.array([1.0])}, {}, 1)


#: what writes, by the suffix of its file, "" for a folder
WRITERS = {
    ".npz": lambda path: result().save(path),
    ".vtu": lambda path: am.export.vtk(result(), path),
    ".pvd": lambda path: am.export.vtk_series([result()], path),
    ".html": lambda path: am.export.Report("a title").write(path),
    "": lambda path: path_result().save(path),
}


def _below_a_file(write, suffix: str) -> None:
    Path("file").write_text("")
    write(f"file/below{suffix}")


def _circle(write, suffix: str) -> None:
    os.symlink(f"circle{suffix}", f"circle{suffix}")
    write(f"circle{suffix}")


def _places():
    for suffix, write in WRITERS.items():
        name = f"to {suffix} path" if suffix else "to a folder"
        yield Hostile(name, lambda w=write: w("~nobody-here/x"), "home", (TypeError, ValueError))
        yield Hostile(
            f"{suffix} below a file",
            lambda w=write, s=suffix: _below_a_file(w, s),
            "file",
            OSError,
            writes=True,
        )
    npz = WRITERS[".npz"]
    for name, run, says, writes in (
        ("a long name", lambda: npz("n" * 300 + ".npz"), "n" * 300, False),
        ("a circle of links", lambda: _circle(npz, ".npz"), "circle", True),
        ("a folder", lambda: (Path("there.npz").mkdir(), npz("there.npz")), "there.npz", True),
        ("no folder", lambda: npz("nowhere/x.npz"), "nowhere", False),
        (
            "a load path to a file",
            lambda: (Path("there").write_text(""), WRITERS[""]("there")),
            "there",
            True,
        ),
        ("a full device", lambda: npz("/dev/full"), "No space left", False),
    ):
        yield Hostile(name, run, says, OSError, writes)
    yield Hostile(
        "a load path twice",
        lambda: (WRITERS[""]("there"), WRITERS[""]("there")),
        "there",
        ValueError,
        True,
    )
    for writer, name in ((".vtu", "r.vtk"), (".pvd", "r.vtu")):
        yield Hostile(
            f"{writer} to {name}", lambda w=writer, n=name: WRITERS[w](n), "path", ValueError
        )


def _contents():
    for name, value in {
        "cycles": object(),
        "levels": [{"level": {1, 2}}],
        "history": {"cycle": np.array(["a"])},
        "versions": {"numpy": np},
        "reaction": np.array([[None]]),
    }.items():
        yield Hostile(
            f"saved {name}",
            lambda n=name, v=value: replace(result(), **{n: v}).save("r.npz"),
            name,
            TypeError,
        )
    yield from each(
        "vtu of a result",
        lambda v: am.export.vtk(v, "r.vtu"),
        {"text": "result", "class": am.Result},
    )
    yield Hostile(
        "vtu without a mesh",
        lambda: am.export.vtk(replace(result(), mesh=None), "r.vtu"),
        "mesh",
        ValueError,
    )
    yield Hostile(
        "a series without results", lambda: am.export.vtk_series([], "r.pvd"), "results", ValueError
    )
    frame = pd.DataFrame({"a": [1]})
    yield Hostile(
        "table of an unknown unit",
        lambda: am.study.as_text(frame, units={"b": "s"}),
        "units",
        ValueError,
    )
    yield Hostile(
        "table of an unknown format",
        lambda: am.study.as_text(frame, formats={"b": "d"}),
        "formats",
        ValueError,
    )


INPUTS = (*_places(), *_contents())
