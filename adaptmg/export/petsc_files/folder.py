"""petsc: a discrete problem, with its hierarchy, as a folder of files that PETSc loads (MatLoad, VecLoad, ISLoad).

The folder appears complete or not at all. ``manifest.json`` says what every file is, in words, with unit, size and
block size; ``README.txt`` says the same to people, and how to load it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from adaptmg.discrete import DiscreteProblem
from adaptmg.export.petsc_files.parts import Part, parts_of_level
from adaptmg.export.petsc_files.readme import readme
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.runtime.atomic import waiting_folder, write_bytes
from adaptmg.runtime.text import printable
from adaptmg.solver.result.labels import versions

__all__ = ["petsc"]

_MANIFEST, _README = "manifest.json", "README.txt"
_FORMAT = "adaptmg for PETSc, 1"


def petsc(problem: Hierarchy | DiscreteProblem, directory: str | os.PathLike[str]) -> Path:
    """Write matrices, loads, prolongations and contact data for PETSc.

    Parameters
    ----------
    problem : Hierarchy or DiscreteProblem
        Of a hierarchy every level is written, ``level0_...`` the coarsest.
    directory : path
        Made here; its parent must exist. One that this function wrote before is replaced; another must be empty.

    Returns
    -------
    pathlib.Path
        The manifest: what every file holds.

    Raises
    ------
    ValueError
        If a matrix has more than 2^31 - 1 nonzeros, which PETSc's default 32-bit indices cannot count; nothing is
        written then.
    OSError
        If the directory holds other files, is a file, or cannot be written.

    Notes
    -----
    Unknown ``dim * node + component``. A u - b is zero but at fixed dofs and at contact nodes, where u.n <= g0,
    p = -r.n >= 0, p (g0 - u.n) = 0, |f_t| <= s + friction p. For several bodies the unknowns at contact nodes are
    relative to the other body, and ``coupling`` gives displacements.
    """
    if isinstance(problem, DiscreteProblem):
        problem = Hierarchy.single(problem)
    checks.instance("problem", problem, Hierarchy, "a Hierarchy or a DiscreteProblem")
    target = Path(os.path.realpath(checks.file_path("directory", directory)))
    _check_target(target)
    parts = [part for number, level in enumerate(problem.levels) for part in parts_of_level(number, level)]
    manifest = _manifest(problem, parts)
    with waiting_folder(target.parent) as waiting:
        made = waiting / "new"
        made.mkdir()
        for part in parts:
            write_bytes(made / f"{part.name}.petsc", part.content())
            if (info := part.info()) is not None:
                write_bytes(made / f"{part.name}.petsc.info", info)
        write_bytes(made / _README, readme(problem, parts).encode())
        write_bytes(made / _MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False).encode())
        if target.exists():
            os.replace(target, waiting / "old")
        os.replace(made, target)
    return target / _MANIFEST


def _manifest(problem: Hierarchy, parts: Sequence[Part]) -> dict[str, object]:
    finest = problem.finest.discrete
    return {"format": _FORMAT, "problem": printable(finest.name), "dim": finest.dim, "levels": len(problem),
            "scalars": "real, 64 bits, big-endian", "integers": "32 bits, big-endian",
            "contact_boundaries": [printable(name) for name in finest.contact.names],
            "versions": versions(), "files": [part.described() for part in parts]}


def _check_target(target: Path) -> None:
    """OSError unless there is nothing, an empty folder, or an older export and nothing else."""
    if not target.parent.is_dir():
        raise FileNotFoundError(f"directory: there is no folder {str(target.parent)!r} to make {target.name!r} in")
    if not target.exists():
        return
    if not target.is_dir():
        raise NotADirectoryError(f"directory must be a folder, but {str(target)!r} is a file")
    foreign = sorted({entry.name for entry in target.iterdir()} - _written(target))
    if foreign:
        raise FileExistsError(f"directory {str(target)!r} holds other files, {foreign[0]!r} for one: give a new folder")


def _written(target: Path) -> set[str]:
    """Names of the files of an older export; empty where there is none."""
    try:
        manifest = json.loads((target / _MANIFEST).read_text(encoding="utf-8"))
        files = [entry["file"] for entry in manifest["files"]] if manifest["format"].startswith(_FORMAT[:17]) else []
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    return {*files, *(f"{name}.info" for name in files), _README, _MANIFEST}
