"""Files that are either complete or not there: the one place where adaptmg writes.

The content goes into a temporary file next to the target, is synchronised with the disk, and then takes the target's
name. A process that is killed meanwhile leaves at most a file ``.adaptmg-*.part``; the next process that writes there
removes those of yesterday.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from pathlib import Path

_OLD = 86400.0  # s: temporary files of this age belong to no living process
_STREAMS = {"/dev/stdout": 1, "/dev/stderr": 2}
_cleaned: set[Path] = set()


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
            _write_all(_STREAMS[os.fspath(path)], content)
        elif status is None or stat.S_ISREG(status.st_mode):
            if status is None and not target.parent.is_dir():
                raise FileNotFoundError(errno.ENOENT, f"the folder {os.fspath(target.parent)!r} does not exist")
            if status is not None and not os.access(target, os.W_OK):
                raise PermissionError(errno.EACCES, "the file is write-protected")
            _replace(target, content, status)
        elif stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, "this is a folder, give the name of a file")
        else:
            with open(path, "wb", buffering=0) as device:
                _write_all(device.fileno(), content)
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


@contextlib.contextmanager
def waiting_folder(folder: Path) -> Iterator[Path]:
    """A folder inside another in which files wait to be put in place together; it is removed in the end."""
    waiting = _part(folder)
    waiting.mkdir()
    try:
        yield waiting
    finally:
        shutil.rmtree(waiting, ignore_errors=True)


def _replace(target: Path, content: bytes, status: os.stat_result | None) -> None:
    """Write a temporary file and give it the target's name."""
    part = _part(target.parent)
    descriptor = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0), 0o666)
    try:
        try:
            _write_all(descriptor, content)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if status is not None:
            os.chmod(part, stat.S_IMODE(status.st_mode))
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


def _write_all(descriptor: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest):]


def _part(folder: Path) -> Path:
    """A new temporary name in a folder; the first time in a process, old ones are removed."""
    if folder not in _cleaned:
        _cleaned.add(folder)
        for old in folder.glob(".adaptmg-*.part"):
            with contextlib.suppress(OSError):
                if time.time() - old.stat().st_mtime > _OLD:
                    shutil.rmtree(old) if old.is_dir() else old.unlink()
    return folder / f".adaptmg-{secrets.token_hex(8)}.part"
