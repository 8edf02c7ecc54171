"""Results of a run that are not numbers: arrays, meshes, solutions, figures and long texts, kept as files.

They are packed into bytes where the run function runs, so that workers need no disk in common with the store, and
written whole by the process that owns the store: ``STORE.files/KEY/NAME-HASH.npz``. The hash of the content in the name
keeps the old file until the row that names the new one is stored; a file whose content has another hash is never
removed. Nothing is pickled.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import os
import re
import shutil
import sys
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, read_bytes, temporary_folder, write_bytes
from adaptmg._text import printable
from adaptmg.mesh.arrays import MeshArrays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from adaptmg.solver.result import Result

#: characters of a text that goes into the row
_LONG = 10_000


@dataclass(frozen=True)
class Packed:
    """A result as the content of a file."""

    ending: str  # of the file: the kind of result, and how it is read
    content: bytes


def pack(value: object) -> Packed | None:
    """Return ``value`` as a file, None if it is not of the kinds that are kept as files."""
    if isinstance(value, str):
        return Packed(".txt", value.encode("utf-8", "surrogatepass")) if len(value) > _LONG else None
    if isinstance(value, np.ndarray) and value.ndim:
        return Packed(".npy", _array(value))
    # without the module loaded there is no object of its class
    if isinstance(value, (MeshArrays, *_loaded("adaptmg.solver.result", "Result"))):
        from adaptmg.solver.result import KINDS
        from adaptmg.solver.store import packed

        return Packed(".mesh.npz" if isinstance(value, MeshArrays) else ".result.npz", packed(value, KINDS))
    if isinstance(value, _loaded("matplotlib.figure", "Figure")):
        return Packed(".svg", _drawn(value))
    return None


def _loaded(module: str, name: str) -> tuple[type, ...]:
    kind = getattr(sys.modules.get(module), name, None)
    return () if kind is None else (kind,)


def _array(array: np.ndarray) -> bytes:
    if isinstance(array, np.ma.MaskedArray):
        raise TypeError("a masked array cannot be kept, as its mask would be lost: return its data and mask")
    if array.dtype.kind not in "biufcUSMm":
        raise TypeError(f"an array of {array.dtype} cannot be kept: return numbers or texts")
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _drawn(figure: Figure) -> bytes:
    import matplotlib

    buffer = io.BytesIO()
    # the same figure is the same file: without a date, with names that follow from the content
    with matplotlib.rc_context({"svg.hashsalt": "adaptmg"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    return buffer.getvalue()


class Folder:
    """The files of the runs in a store; a temporary folder for a store in memory."""

    def __init__(self, store: Path | None) -> None:
        # it need not exist
        self.path = temporary_folder() if store is None else store.with_name(f"{store.name}.files")
        if store is None:
            weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)

    def write(self, study: str, key: str, packed: Mapping[str, Packed]) -> dict[str, str]:
        """Write the files of a run, each whole; return their paths in the folder by name of the result."""
        folder = hashlib.sha256(f"{study}\0{key}".encode()).hexdigest()[:24]
        written = {}
        for name, item in packed.items():
            plain = f"{re.sub(r'[^A-Za-z0-9_.-]', '_', name)[:60]}-{_digest(item.content)}"
            try:
                make_folder("the folder of the store's files", self.path / folder)
                for k in itertools.count():
                    # where something else has the name, a damaged file or a link, it stays
                    written[name] = f"{folder}/{plain}{f'.{k}' if k else ''}{item.ending}"
                    if not os.path.lexists(self.path / written[name]):
                        write_bytes(self.path / written[name], item.content)
                        break
                    if self._content(written[name]) is not None:
                        break
            except OSError as error:
                raise OSError(f"{printable(os.fspath(self.path))}: {error.strerror or error}: make room, or check its "
                              "permissions") from error
        return written

    def remove(self, old: Mapping[str, str], new: Mapping[str, str]) -> None:
        """Remove files of a run that its new row does not name; only those that hold what was written."""
        for path in set(old.values()) - set(new.values()):
            if self._content(path) is not None:
                with contextlib.suppress(OSError):
                    self._file(path).unlink()

    def read(self, path: str) -> np.ndarray | MeshArrays | Result | str | Path:
        """Return the content of a file: an array, a mesh, a result, a text; of a figure the path of its SVG file."""
        file = self._file(path)
        if not file.exists():
            raise FileNotFoundError(f"{file} is missing: run that point again (rerun=True)")
        content = self._content(path)
        if content is None:
            raise ValueError(f"{file} is damaged (its content is not what was written): run that point again "
                             "(rerun=True)")
        if file.name.endswith(".svg"):
            return file
        if file.name.endswith(".txt"):
            return content.decode("utf-8", "surrogatepass")
        if file.name.endswith(".npy"):
            return np.load(io.BytesIO(content), allow_pickle=False)
        from adaptmg.solver.result import KINDS
        from adaptmg.solver.store import read

        return read(file, (MeshArrays,) if file.name.endswith(".mesh.npz") else KINDS).value

    def _content(self, path: str) -> bytes | None:
        """The content of a file that was written here, None if it is not there or another."""
        with contextlib.suppress(ValueError, OSError):
            file = self._file(path)
            content = read_bytes(file)
            return content if f"-{_digest(content)}." in file.name else None
        return None

    def _file(self, path: str) -> Path:
        """Return the path of a plain file in this folder, which need not exist; a row may come from elsewhere."""
        base = Path(os.path.realpath(self.path))
        target = base / path
        if base not in target.parents or os.path.realpath(target) != str(target) \
                or (os.path.exists(target) and not os.path.isfile(target)):
            raise ValueError(f"{checks.shown(path)} does not name a file of this store")
        return target


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]
