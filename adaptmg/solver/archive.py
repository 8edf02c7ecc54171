"""Arrays of an ``.npz`` file, read by a stranger: what it declares is checked before anything is unpacked.

An ``.npz`` file is a zip archive of ``.npy`` files. A small one may declare terabytes (a zip bomb), in the directory of
the archive or in the headers of the arrays, so that both are read first, and held against each other.
"""

from __future__ import annotations

import ast
import os
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptmg.problem import checks
from adaptmg.runtime.text import printable

__all__ = ["DAMAGES", "read_arrays"]

#: what broken archives, arrays and JSON make numpy, zipfile and json raise
DAMAGES = (ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, NotImplementedError, RuntimeError,
           RecursionError, MemoryError, SyntaxError, AttributeError, zipfile.BadZipFile, zlib.error, struct.error)

#: arrays in a file; a result has about 40
_MOST_ARRAYS = 10_000
#: displacements do not shrink, so that a whole result shrinks some ten times at most
_MOST_SHRINKING, _SMALL = 200, 64 * 2**20
_MAGIC, _HEADER_LIMIT = b"\x93NUMPY", 1000


@dataclass(frozen=True)
class _Header:
    """What a ``.npy`` file says of itself."""

    shape: tuple[int, ...]
    dtype: np.dtype
    fortran: bool
    length: int

    @property
    def size(self) -> int:
        """Bytes of the whole file; of Python's unbounded integers, so that nothing wraps."""
        size = self.length + self.dtype.itemsize
        if 0 in self.shape:
            return self.length
        for count in self.shape:
            size = self.length + (size - self.length) * count
        return size


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an ``.npz`` file by name; numbers only, nothing is unpickled.

    Raises
    ------
    ValueError
        If it is no such file, or a damaged or hostile one; the message begins with the path.
    OSError
        If it cannot be opened.
    """
    where = printable(os.fspath(path))
    if path.is_dir():
        raise ValueError(f"{where} is a folder, a file is wanted")
    if path.exists() and not path.is_file():
        raise ValueError(f"{where} is a device or a pipe, a file is wanted")
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                entries = _entries(archive, os.fstat(file.fileno()).st_size)
                headers = {name: _header(archive, entry) for name, entry in entries.items()}
                return {name: _array(archive, entries[name], header) for name, header in headers.items()}
        except (*DAMAGES, OSError) as error:  # zipfile seeks where a cut archive tells it to
            raise ValueError(f"{where} is damaged, or no .npz file ({error or type(error).__name__})") from error


def _entries(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The entries by name of the array, their declared sizes checked."""
    listed = archive.infolist()
    if len(listed) > _MOST_ARRAYS:
        raise ValueError(f"it lists {len(listed)} arrays, at most {_MOST_ARRAYS} are read")
    entries = {entry.filename.removesuffix(".npy"): entry for entry in listed}
    if len(entries) < len(listed):
        raise ValueError("it lists an array twice")
    for entry in listed:
        if not entry.filename.endswith(".npy") or entry.flag_bits & 1:
            raise ValueError(f"{checks.shown(entry.filename)} is no plain array")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{checks.shown(entry.filename)} is compressed in an unknown way")
    packed, unpacked = sum(e.compress_size for e in listed), sum(e.file_size for e in listed)
    if packed > size:
        raise ValueError(f"it lists {packed} bytes, but has {size}")
    if unpacked > _SMALL and unpacked > _MOST_SHRINKING * size:
        raise ValueError(f"{size} bytes would unpack to {unpacked}: that is no result")
    checks.fits("its arrays", unpacked, "unpacked they")
    return entries


def _header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> _Header:
    """Header of an array, held against the size in the archive."""
    with archive.open(entry) as file:
        start = file.read(12)
        if start[:6] != _MAGIC or len(start) < 12 or start[6] not in (1, 2, 3):
            raise ValueError(f"{entry.filename} is no .npy file")
        prefix, length = (10, struct.unpack("<H", start[8:10])[0]) if start[6] == 1 else \
            (12, struct.unpack("<I", start[8:12])[0])
        if not 2 <= length <= _HEADER_LIMIT:
            raise ValueError(f"{entry.filename} has a header of {length} bytes")
        text = (start[prefix:] + file.read(length - (12 - prefix))).decode("utf-8" if start[6] == 3 else "latin-1")
    said = ast.literal_eval(text)
    if not isinstance(said, dict) or not isinstance(said["descr"], str) or type(said["fortran_order"]) is not bool \
            or not isinstance(said["shape"], tuple):
        raise ValueError(f"{entry.filename} has a header that says {checks.shown(said)}")
    shape = tuple(checks.integer(f"the shape of {entry.filename}", count) for count in said["shape"])
    dtype = np.dtype(said["descr"])
    if dtype.kind not in "biuf":
        raise ValueError(f"{entry.filename} holds {dtype}, no numbers")
    header = _Header(shape, dtype, said["fortran_order"], prefix + length)
    if header.size != entry.file_size:
        raise ValueError(f"{entry.filename} has {entry.file_size} bytes, its header says {header.size}")
    return header


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, header: _Header) -> np.ndarray:
    # reads to the end, so that zipfile compares the checksum
    flat = np.frombuffer(archive.read(entry), dtype=header.dtype, offset=header.length)
    # a copy, which can be written to
    flat = flat.astype(header.dtype.newbyteorder("="))
    return flat.reshape(header.shape, order="F" if header.fortran else "C")
