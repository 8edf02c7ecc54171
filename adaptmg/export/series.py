"""vtk_series: results of load steps as a ParaView collection, a .vtu file a step and a .pvd file that lists them."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from adaptmg.export.vtu import document
from adaptmg.problem import check_arrays, checks
from adaptmg.runtime.atomic import waiting_folder, write_bytes
from adaptmg.runtime.text import printable
from adaptmg.solver.result import Result

__all__ = ["vtk_series"]


def vtk_series(results: Sequence[Result], path: str | os.PathLike[str], times: Sequence[float] | None = None
               ) -> Path:
    """Write a sequence of results for ParaView; see :mod:`adaptmg.export.vtu` for the fields.

    Parameters
    ----------
    results : sequence of Result
        With meshes, one a step.
    path : path
        The ``.pvd`` file, in a directory that exists; or a folder, made where it is missing (its parent exists), for a
        ``.pvd`` file of the folder's name. The steps lie beside the ``.pvd`` file: ``run_0000.vtu``, ... for
        ``run.pvd``. All steps are written before any is put in place, and the ``.pvd`` file comes last: where it is
        there, all it lists is there. An older one of the same name is removed before its steps are replaced.
    times : sequence of float, optional
        Strictly increasing; default 0, 1, 2, ... (load factors that fall are no times: give pseudo-times).

    Returns
    -------
    pathlib.Path
        The ``.pvd`` file: what to open.

    Raises
    ------
    ValueError
        For no results, times that do not increase, or whatever :func:`adaptmg.export.vtk` refuses in a step; nothing
        is written then.
    """
    results = list(results)
    if not results:
        raise ValueError("results is empty: a series needs at least one step")
    times = np.arange(len(results), dtype=float) if times is None else check_arrays.vector("times", times)
    if len(times) != len(results):
        raise ValueError(f"times must have one value a result: {len(results)} results, {len(times)} times")
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must increase strictly, got {times.tolist()}: for load factors that fall or stay give "
                         "pseudo-times, or leave times out")
    given = checks.file_path("path", path)
    target = _target(given)
    names = [f"{target.stem}_{k:04d}.vtu" for k in range(len(results))]
    _check_target(target)
    folder_is_new = target.parent == given and not target.parent.exists()
    if folder_is_new:
        target.parent.mkdir()
    try:
        with waiting_folder(target.parent) as waiting:
            for name, result in zip(names, results, strict=True):
                write_bytes(waiting / name, document(result))
            # of a link what it leads to: the new one is written through it
            if target.exists():
                Path(os.path.realpath(target)).unlink()
            for name in names:
                os.replace(waiting / name, target.parent / name)
        write_bytes(target, _collection(names, times))
    except BaseException:
        if folder_is_new and not any(target.parent.iterdir()):
            target.parent.rmdir()
        raise
    return target


def _target(path: Path) -> Path:
    """The .pvd file for a .pvd file or a folder."""
    if path.suffix == ".pvd":
        return path
    if path.suffix in (".vtu", ".vtk", ".xdmf") or path.is_file():
        raise ValueError(f"path must be a .pvd file or a folder, got {os.fspath(path)!r}")
    return path / f"{path.name}.pvd"


def _check_target(target: Path) -> None:
    """OSError for a path that can be no file, before any step is written."""
    try:
        there = target.stat()
    except FileNotFoundError:
        return
    if stat.S_ISDIR(there.st_mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, give the name of a file", str(target))


def _collection(names: Sequence[str], times: np.ndarray) -> bytes:
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0">', "<Collection>"]
    lines += [f'<DataSet timestep="{float(time)!r}" part="0" file={quoteattr(printable(name))}/>'
              for name, time in zip(names, times, strict=True)]
    return "\n".join([*lines, "</Collection>", "</VTKFile>", ""]).encode()
