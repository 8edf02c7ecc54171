"""Files: the one place where adaptmg writes them, and the one where it opens those of others.

What is written is either complete or not there. The content goes into a temporary file next to the target, is
synchronised with the disk, and then takes the target's name. A process that is killed meanwhile leaves at most
``.adaptmg-HOST-PID-TOKEN.part``; the next process of the same user that writes there removes it, if process PID of
this machine has ended. What is read is a regular file of a bounded size, never a pipe or a device.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

from adaptmg._machine import process_space, user
from adaptmg._text import printable

#: bytes of a file that is read, unless a smaller limit is given
MOST_BYTES = 2**36
_STREAMS = {"/dev/stdout": 1, "/dev/stderr": 2}
_PART = re.compile(r"\.adaptmg-([0-9a-f]{8})-([0-9]{1,9})-[0-9a-f]{16}\.part")
_cleaned: set[Path] = set()


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], most: float = MOST_BYTES) -> Iterator[BinaryIO]:
    """Open a regular file for reading; ValueError for a folder, device or pipe, and for more than ``most`` bytes."""
    # a pipe without a writer would wait
    flags, shown = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0), printable(os.fspath(path))
    if os.path.isdir(path):
        raise ValueError(f"{shown} must be a file, not a folder, device or pipe")
    with open(os.open(path, os.O_RDONLY | flags), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ValueError(f"{shown} must be a file, not a folder, device or pipe")
        if status.st_size > most:
            raise ValueError(f"{shown} must have at most {most:.3g} bytes, it has {status.st_size:.3g}")
        yield file


def read_bytes(path: str | os.PathLike[str], most: float = MOST_BYTES) -> bytes:
    """Return the content of a regular file; as :func:`opened`."""
    with opened(path, most) as file:
        # no more than the size says: files of the system may have no end
        return file.read(os.fstat(file.fileno()).st_size)


def file_size(name: str, path: Path) -> int:
    """Return the size of a regular file that another process will read; FileNotFoundError if there is none."""
    try:
        with opened(path) as file:
            return os.fstat(file.fileno()).st_size
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{name}: there is no file {printable(os.fspath(path))!r}") from error


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file, so that no reader ever sees half of it, not even after a power cut. Symbolic links are followed and
    ``~`` is expanded. An existing file keeps its permissions, a new one gets those of the umask. Devices and pipes are
    written to."""
    path = Path(path).expanduser()
    target = Path(os.path.realpath(path))
    try:
        status = None
        with contextlib.suppress(FileNotFoundError):  # but not a circle of links, say
            status = path.stat()
        if os.fspath(path) in _STREAMS:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()  # printed text comes first
            with open(_STREAMS[os.fspath(path)], "wb", closefd=False) as file:
                file.write(content)
        elif status is None or stat.S_ISREG(status.st_mode):
            if status is None and not target.parent.is_dir():
                raise FileNotFoundError(errno.ENOENT, f"the folder {os.fspath(target.parent)!r} does not exist")
            if status is not None and not os.access(target, os.W_OK):
                raise PermissionError(errno.EACCES, "the file is write-protected")
            _replace(target, content, status)
        elif stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, "this is a folder, give the name of a file")
        else:
            path.write_bytes(content)
    except OSError as error:
        # the system names the temporary file, or none
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def make_folder(name: str, path: Path) -> None:
    """Make a folder and those above it where they are missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise NotADirectoryError(errno.ENOTDIR, f"{name} must be a folder, but a file is in the way",
                                 str(path)) from error


def temporary_folder(folder: str | os.PathLike[str] = "") -> Path:
    """Make a folder inside another one, by default that of temporary files; after a kill the next process removes it,
    in place of the caller."""
    made = _part(Path(folder or tempfile.gettempdir()))
    made.mkdir(mode=0o700)
    return made


@contextlib.contextmanager
def waiting_folder(folder: str | os.PathLike[str] = "") -> Iterator[Path]:
    """A :func:`temporary_folder`, for files that are put in place together, which is removed in the end."""
    waiting = temporary_folder(folder)
    try:
        yield waiting
    finally:
        shutil.rmtree(waiting, ignore_errors=True)


def _replace(target: Path, content: bytes, status: os.stat_result | None) -> None:
    """Write a temporary file and give it the target's name."""
    part = _part(target.parent)
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if status is not None:
            part.chmod(stat.S_IMODE(status.st_mode))
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):  # not every file system synchronises folders
        descriptor = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _part(folder: Path) -> Path:
    """A new temporary name in a folder; the first time in a process, what ended processes left there is removed."""
    if folder not in _cleaned:
        _cleaned.add(folder)
        for path in folder.glob(".adaptmg-*.part"):
            with contextlib.suppress(OSError):
                if (match := _PART.fullmatch(path.name)) and match[1] == _host() and _left(path, int(match[2])):
                    (shutil.rmtree if path.is_dir() and not path.is_symlink() else Path.unlink)(path)
    return folder / f".adaptmg-{_host()}-{os.getpid()}-{secrets.token_hex(8)}.part"


@lru_cache(maxsize=1)
def _host() -> str:
    return hashlib.sha256(process_space().encode()).hexdigest()[:8]


def _left(path: Path, pid: int) -> bool:
    """Whether it belongs to this user and the process that made it has ended."""
    import psutil

    return not psutil.pid_exists(pid) and path.lstat().st_uid == user()
