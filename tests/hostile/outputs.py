"""Files that cannot be written, and results, names and tables that cannot be written to them."""

from __future__ import annotations

import functools
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from hostile_table import Hostile

import adaptmg as am
from adaptmg.study import as_html, as_text

sys.path.append(str(Path(__file__).parents[1] / "helpers"))


@functools.cache
def result() -> am.Result:
    from made import result_on, square

    return result_on(square(2))


def path_result() -> am.PathResult:
    return am.PathResult((result(),), {"left": np.array([1.0])}, {}, 1)


def page(path: object) -> None:
    from adaptmg.export import Report

    Report("a title").write(path)


#: what writes, by the suffix of its file
WRITERS = {".npz": lambda path: result().save(path), ".vtu": lambda path: am.export.vtk(result(), path),
           ".pvd": lambda path: am.export.vtk_series([result()], path), ".html": page,
           "": lambda path: path_result().save(path)}


def _below_a_file(write, suffix: str) -> None:
    Path("file").write_text("")
    write(f"file/below{suffix}")


def _folder_there(write, suffix: str) -> None:
    Path(f"there{suffix}").mkdir()
    write(f"there{suffix}")


def _circle(write, suffix: str) -> None:
    os.symlink(f"circle{suffix}", f"circle{suffix}")
    write(f"circle{suffix}")


def _places():
    for suffix, write in WRITERS.items():
        label = suffix or "load path"
        for name, path in {"None": None, "a number": 3, "empty": "", "a zero byte": f"a\0{suffix}", "bytes": b"a",
                           "a class": Path, "nobody's home": f"~nobody-here/x{suffix}"}.items():
            yield Hostile(f"{label} to {name}", lambda w=write, p=path: w(p), "folder" if not suffix else "path")
        yield Hostile(f"{label} with a long name", lambda w=write, s=suffix: w("n" * 300 + s), "n" * 300, OSError)
        yield Hostile(f"{label} below a file", lambda w=write, s=suffix: _below_a_file(w, s), "file",
                      OSError, writes=True)
        yield Hostile(f"{label} to a circle of links", lambda w=write, s=suffix: _circle(w, s), "circle", OSError,
                      writes=True)
        if suffix:
            yield Hostile(f"{label} to a folder", lambda w=write, s=suffix: _folder_there(w, s), f"there{suffix}",
                          OSError, writes=True)
            yield Hostile(f"{label} to no folder", lambda w=write, s=suffix: w(f"nowhere/x{s}"), "nowhere", OSError)
    yield Hostile("a load path to a file", lambda: (Path("there").write_text(""), path_result().save("there")), "there",
                  OSError, writes=True)
    yield Hostile("a load path twice", lambda: (path_result().save("there"), path_result().save("there")), "there",
                  ValueError, writes=True)
    yield Hostile("to a full device", lambda: result().save("/dev/full"), "No space left", OSError)
    yield Hostile("vtu of another suffix", lambda: am.export.vtk(result(), "r.vtk"), "path", ValueError)
    yield Hostile("vtu without a suffix", lambda: am.export.vtk(result(), "vtu"), "path", ValueError)
    yield Hostile("a series to a .vtu", lambda: am.export.vtk_series([result()], "r.vtu"), "path", ValueError)


def _contents():
    wrong = {"cycles": object(), "timings": {"setup": 1j}, "levels": [{"level": {1, 2}}], "path": [(0, b"smooth", 1)],
             "history": {"cycle": np.array(["a"])}, "versions": {"numpy": np}, "problem_name": b"x",
             "reaction": np.array([[None]])}
    for name, value in wrong.items():
        yield Hostile(f"saved {name}", lambda n=name, v=value: replace(result(), **{n: v}).save("r.npz"), name,
                      TypeError)
    yield Hostile("vtu of no result", lambda: am.export.vtk("result", "r.vtu"), "result", TypeError)
    yield Hostile("vtu of a class", lambda: am.export.vtk(am.Result, "r.vtu"), "result", TypeError)
    bare = functools.partial(replace, mesh=None)
    yield Hostile("vtu without a mesh", lambda: am.export.vtk(bare(result()), "r.vtu"), "mesh", ValueError)
    yield Hostile("a series of nothing", lambda: am.export.vtk_series([], "r.pvd"), "results", ValueError)
    frame = pd.DataFrame({"a": [1]})
    for form in (as_text, as_html):
        yield Hostile(f"{form.__name__} unknown unit", lambda f=form: f(frame, units={"b": "s"}), "units", ValueError)
        yield Hostile(f"{form.__name__} unknown format", lambda f=form: f(frame, formats={"b": "d"}), "formats",
                      ValueError)


INPUTS = (*_places(), *_contents())
