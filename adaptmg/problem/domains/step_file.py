"""StepFile: the solids of a STEP file as a domain; the mesh layer reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from adaptmg.problem import checks
from adaptmg.problem.domains.straight import Domain

__all__ = ["StepFile"]


@dataclass(frozen=True)
class StepFile(Domain):
    """The solids of a STEP file, each a body; boundaries are called "solid.face".

    Names come from the file; solids and faces without one are called ``solid1``, ``face1``, ... in the order of the
    file. Of several solids with one name the later ones get "_2", "_3", ...; a "." becomes "_". Names are known only
    when the file is read (:func:`adaptmg.mesh.netgen.step.step_names` lists them).

    Parameters
    ----------
    path : str or Path
        A ``.step`` or ``.stp`` file.
    unit : float
        Length in m of one unit of the coordinates, after the reader has turned all units of length into millimetres:
        leave it at 1e-3 unless the file states a wrong unit.
    names : mapping of str to str
        New names: "solid1": "upper" of a solid, "solid1.face3": "contact" of one of its faces. Keys are names as in
        the file, or solids and faces by their numbers, counted from 1.
    """

    path: str | Path
    unit: float = 1e-3
    names: Mapping[str, str] = field(default_factory=dict, hash=False)
    dim: ClassVar[int] = 3
    boundaries: ClassVar[None] = None
    bodies: ClassVar[None] = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", checks.file_path("path", self.path))
        object.__setattr__(self, "unit", checks.quantity("unit", self.unit, positive=True))
        if self.names is None:
            object.__setattr__(self, "names", {})
        if not isinstance(self.names, Mapping):
            raise TypeError(f"names must map names to names, got {checks.shown(self.names)}")
        object.__setattr__(self, "names", dict(self.names))
        for old, new in self.names.items():
            checks.boundary_name("the keys of names", old)
            if "." in checks.boundary_name(f"names[{old!r}]", new):
                raise ValueError(f"names[{old!r}] must not contain '.', got {new!r}: boundaries are 'solid.face'")
