"""Results of a run that are no numbers: arrays, meshes, solutions, figures and long texts, kept as files.

What a run function returns of these kinds is packed into bytes where it runs, so that workers need no disk in common
with the store, and written whole by the process that owns the store: ``STORE.files/KEY/NAME-HASH.npz``. The hash of the
content in the name keeps the old file until the row that names the new one is stored. Nothing is pickled.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg._text import printable
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["Folder", "Packed", "pack"]

#: characters of a text that goes into the row
_LONG = 10_000
_MESH = ("points", "elements", "facets", "facet_labels", "element_body")


@dataclass(frozen=True)
class Packed:
    """A result as the content of a file."""

    ending: str  # of the file: what kind it is, and how it is read
    content: bytes


def pack(value: Any) -> Packed | None:
    """``value`` as a file, None if it is not of the kinds that are kept so."""
    if isinstance(value, str):
        return Packed(".txt", value.encode("utf-8", "surrogatepass")) if len(value) > _LONG else None
    if isinstance(value, np.ndarray) and value.ndim:
        return _of_arrays(".npy", value)
    if isinstance(value, MeshArrays):
        arrays = {name: getattr(value, name) for name in _MESH}
        texts = {name: np.array(getattr(value, name), dtype=str) for name in ("boundaries", "bodies")}
        return Packed(".mesh.npz", _npz(arrays | texts))
    kinds = {".result.npz": ("adaptmg.solver.result", "Result"), ".svg": ("matplotlib.figure", "Figure")}
    for ending, (module, name) in kinds.items():
        # who has not loaded the module has no object of it
        kind = getattr(sys.modules.get(module), name, None)
        if kind is not None and isinstance(value, kind):
            return Packed(ending, _figure(value) if ending == ".svg" else _saved(value))
    return None


def _of_arrays(ending: str, array: np.ndarray) -> Packed:
    if isinstance(array, np.ma.MaskedArray):
        raise TypeError("a masked array cannot be kept, as its mask would be lost: return its data and mask")
    if array.dtype.kind not in "biufcUSMm":
        raise TypeError(f"an array of {array.dtype} cannot be kept: return numbers or texts")
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return Packed(ending, buffer.getvalue())


def _npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _figure(figure: Any) -> bytes:
    import matplotlib

    buffer = io.BytesIO()
    # without date and with names that follow from the content the same figure is the same file
    with matplotlib.rc_context({"svg.hashsalt": "adaptmg"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    return buffer.getvalue()


def _saved(result: Any) -> bytes:
    with tempfile.TemporaryDirectory(prefix="adaptmg-") as folder:
        file = Path(folder, "result.npz")
        result.save(file)
        return file.read_bytes()


def _unpack(file: Path) -> Any:
    """What is in a file; ValueError that names it if it is damaged."""
    try:
        content = file.read_bytes()
        if f"-{_digest(content)}." not in file.name:
            raise ValueError("its content is not what was written")
        if file.name.endswith(".svg"):
            return file
        if file.name.endswith(".txt"):
            return content.decode("utf-8", "surrogatepass")
        if file.name.endswith(".npy"):
            return np.load(io.BytesIO(content), allow_pickle=False)
        if file.name.endswith(".mesh.npz"):
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                return MeshArrays(**{name: arrays[name] for name in _MESH},
                                  **{name: tuple(arrays[name].tolist()) for name in ("boundaries", "bodies")})
    except FileNotFoundError:
        raise FileNotFoundError(f"{file} is no longer there: run that point again (rerun=True)") from None
    except Exception as error:  # of zip files and numpy too, as a store may come from elsewhere
        raise ValueError(f"{file} is damaged ({error}): run that point again (rerun=True)") from error
    from adaptmg.solver.result import Result

    return Result.load(file)


def _digest(content: bytes) -> str:
    """What the name of a file says of its content."""
    return hashlib.sha256(content).hexdigest()[:12]


def _write_all(base: Path, contents: Mapping[str, bytes]) -> None:
    """Files by their paths from ``base``, each whole."""
    for path, content in contents.items():
        target = base / path
        make_folder("the folder of the store's files", target.parent)
        if target.is_symlink() or not target.is_file():
            target.unlink(missing_ok=True)  # a link or a pipe would be followed
        write_bytes(target, content)


class Folder:
    """The files of the runs in a store."""

    def __init__(self, store: Path | None) -> None:
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._store = store
        self._trouble = ""

    @property
    def path(self) -> Path:
        """The folder; it need not be there."""
        if self._store is not None:
            return self._store.with_name(f"{self._store.name}.files")
        if self._temporary is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="adaptmg-study-")
        return Path(self._temporary.name)

    def write(self, study: str, key: str, packed: Mapping[str, Packed]) -> dict[str, str]:
        """Write the files of a run, each whole; their paths from the folder, by name of the result."""
        if not packed:
            return {}
        folder = hashlib.sha256(f"{study}\0{key}".encode()).hexdigest()[:24]
        written = {}
        for name, item in packed.items():
            plain = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:60]
            written[name] = f"{folder}/{plain}-{_digest(item.content)}{item.ending}"
        contents = {written[name]: item.content for name, item in packed.items()}
        try:
            _write_all(self.path, contents)
        except OSError as error:
            self._write_elsewhere(contents, error)
        return written

    def _write_elsewhere(self, contents: Mapping[str, bytes], error: OSError) -> None:
        """Where there is room; :meth:`told` tells of it."""
        told = f"{printable(os.fspath(self.path))}: {error.strerror or error}: make room, or look at its permissions"
        for base in (Path(tempfile.gettempdir()), Path.home()):
            target = base / f"{self.path.name}.rescued-{os.getpid()}"
            with contextlib.suppress(OSError):
                _write_all(target, contents)
                self._trouble = (f"{told}. The files of runs that are done are safe in {printable(os.fspath(target))}: "
                                "copy the folders in it there")
                return
        raise OSError(f"{told}; files of a run could not be written elsewhere either, run it again") from error

    def told(self) -> str:
        """What to tell the user of files that could not be written where they belong; once."""
        trouble, self._trouble = self._trouble, ""
        return trouble

    def remove(self, old: Mapping[str, str], new: Mapping[str, str]) -> None:
        """Remove files of a run that its new row does not name; what is not a file of this store stays."""
        for path in set(old.values()) - set(new.values()):
            with contextlib.suppress(ValueError, OSError):
                self._file(path).unlink(missing_ok=True)

    def read(self, path: str) -> Any:
        """What is in a file: an array, a mesh, a result, a text; of a figure the path of its SVG file."""
        return _unpack(self._file(path))

    def _file(self, path: str) -> Path:
        """A path of a row, which may come from elsewhere: of a plain file in this folder, or of none yet."""
        base = Path(os.path.realpath(self.path))
        target = base / path
        if base not in target.parents or os.path.realpath(target) != str(target) \
                or (os.path.exists(target) and not os.path.isfile(target)):
            raise ValueError(f"{checks.shown(path)} is no file of this store")
        return target
