"""Files: the one place where adaptmg writes them, and the one where it opens those of others.

What is written is either complete or not there. The content goes into a temporary file next to the
target, is synchronised with the disk, and then takes the target's name. A process that is killed
meanwhile leaves at most ``.adaptmg-PROCESS-TOKEN.part``, which the next process that writes there
removes. What is read is a regular file of a bounded size,
never a pipe or a device."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import BinaryIO

from adaptmg._machine import has_ended, process_name
from adaptmg._text import printable

#: bytes of a file that is read, unless a smaller limit is given
MOST_BYTES = 2**36


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], most: float = MOST_BYTES) -> Iterator[BinaryIO]:
    """Open a regular file for reading; ValueError for a folder, device or pipe, and for more than
    ``most`` bytes."""
    # a pipe without a writer would wait
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    shown = printable(os.fspath(path))
    if os.path.isdir(path):
        raise ValueError(f"{shown} must be a file, not a folder, device or pipe")
    with open(os.open(path, os.O_RDONLY | flags), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ValueError(f"{shown} must be a file, not a folder, device or pipe")
        if status.st_size > most:
            raise ValueError(
                f"{shown} must have at most {most:.3g} bytes, it has {status.st_size:.3g}"
            )
        yield file


def read_bytes(path: str | os.PathLike[str], most: float = MOST_BYTES) -> bytes:
    """Return the content of a regular file; as :func:`opened`."""
    with opened(path, most) as file:
        # no more than the size says: files of the system may have no end
        return file.read(os.fstat(file.fileno()).st_size)


def file_size(name: str, path: Path) -> int:
    """Return the size of a regular file that another process will read; FileNotFoundError if there
    is none."""
    try:
        with opened(path) as file:
            return os.fstat(file.fileno()).st_size
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{name}: there is no file {printable(os.fspath(path))!r}"
        ) from error


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file, so that no reader ever sees half of it, not even after a power cut. Symbolic
    links are followed and ``~`` is expanded. An existing file keeps its permissions, a new one gets
    those of the umask. Devices and pipes are written to."""
    path = Path(path).expanduser()
    target = Path(os.path.realpath(path))
    try:
        status = None
        with contextlib.suppress(FileNotFoundError):  # but not a circle of links, say
            status = path.stat()
        if status is None or stat.S_ISREG(status.st_mode):
            if status is None and not target.parent.is_dir():
                raise FileNotFoundError(
                    errno.ENOENT, f"the folder {os.fspath(target.parent)!r} does not exist"
                )
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
        raise NotADirectoryError(
            errno.ENOTDIR, f"{name} must be a folder, but a file is in the way", str(path)
        ) from error


@contextlib.contextmanager
def waiting_folder(folder: str | os.PathLike[str] | None = None) -> Iterator[Path]:
    """Make a folder inside another one, by default that of temporary files, for files that are put in
    place together; it is removed in the end."""
    _remove_leftovers(Path(folder or tempfile.gettempdir()))
    with tempfile.TemporaryDirectory(
        ".part", f"{_prefix()}-", folder, ignore_cleanup_errors=True
    ) as waiting:
        yield Path(waiting)


def _prefix() -> str:
    """Return the prefix of the names of temporary files of this process."""
    return f".adaptmg-{process_name(os.getpid())}"


@cache
def _remove_leftovers(folder: Path) -> None:
    """Remove, once in a process, the temporary files that processes left in a folder when they were
    killed."""
    for part in folder.glob(".adaptmg-*.part"):
        writer = re.fullmatch(r"\.adaptmg-(.*)-\w+\.part", part.name)
        if writer is None or not has_ended(writer[1]):
            continue
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                part.unlink()


def _replace(target: Path, content: bytes, status: os.stat_result | None) -> None:
    """Write a temporary file and give it the target's name."""
    _remove_leftovers(target.parent)
    part = target.with_name(f"{_prefix()}-{secrets.token_hex(8)}.part")
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
