"""Files that are either complete or not there: the one place where adaptmg writes.

The content goes into a file without a name (``O_TMPFILE``, where the system has it), which gets its name when it is
whole: a process that is killed meanwhile leaves nothing. Where a file is replaced, or the system has no such files, it
lies beside the target for a moment, under a short name that tells the process; what dead processes left so is removed
by the next that writes there.

Compiled kernels where nothing can be written, and with a damaged or full cache: slower, but they run.

numba keeps compiled functions beside their source or in the home directory. Where neither can be written it refuses to
compile them at all ("no locator available"); then they are kept in the directory of temporary files, or nowhere. A
cache file that cannot be read is taken for missing, and one that cannot be written (a full disk) is left out. Each
time a warning is logged. Functions of other packages stay as numba has them.
"""

from __future__ import annotations

import contextlib
import errno
import importlib.abc
import importlib.util
import logging
import os
import re
import secrets
import shutil
import socket
import stat
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

__all__ = ["install", "make_folder", "waiting_folder", "write_bytes"]

_HOST = f"{zlib.crc32(socket.gethostname().encode()):08x}"
_PART = re.compile(rf"\.adaptmg-{_HOST}-(\d+)-[0-9a-f]+\.part")
_STREAM = re.compile(r"/dev/fd/(\d+)|/proc/self/fd/(\d+)|/dev/std(in|out|err)")
_cleaned: set[Path] = set()
_cleaning = threading.Lock()


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file, so that a reader never sees half of it, and neither does who comes after a power cut.

    A symbolic link is followed. A file that is there keeps its permissions; a new one has those of the umask. Devices
    and pipes are written to. ``~`` is expanded.
    """
    given = Path(path).expanduser()
    descriptor = _stream(given)
    if descriptor is not None:
        _write_stream(descriptor, content)
        return
    target = Path(os.path.realpath(given))
    there = _status(given)
    if there is None:
        _check_folder(target.parent, given)
    elif stat.S_ISDIR(there.st_mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, give the name of a file", str(given))
    elif not stat.S_ISREG(there.st_mode):
        with open(given, "wb", buffering=0) as device:
            _write_all(device.fileno(), content)
        return
    elif not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "the file is write-protected", str(given))
    _clean(target.parent)
    try:
        _replace(target, content, None if there is None else stat.S_IMODE(there.st_mode))
    except OSError as error:
        # of a file that is open the system does not say which one it is
        raise OSError(error.errno, error.strerror or str(error), str(given)) from error


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
    _clean(folder)
    waiting = _part(folder)
    waiting.mkdir()
    try:
        yield waiting
    finally:
        shutil.rmtree(waiting, ignore_errors=True)


def _part(folder: Path) -> Path:
    """A new name that tells this process."""
    return folder / f".adaptmg-{_HOST}-{os.getpid()}-{secrets.token_hex(4)}.part"


def _stream(path: Path) -> int | None:
    """Number of the open file that a name such as /dev/stdout stands for.

    Opened anew, a file behind it would be cut off, and what is written later would write over it.
    """
    match = _STREAM.fullmatch(os.path.abspath(path)) if os.name == "posix" else None
    if match is None:
        return None
    number = match[1] or match[2] or {"in": 0, "out": 1, "err": 2}[match[3]]
    return int(number)


def _write_stream(descriptor: int, content: bytes) -> None:
    for stream in (sys.stdout, sys.stderr):
        # what was printed before comes first
        if stream is not None:
            stream.flush()
    _write_all(descriptor, content)


def _write_all(descriptor: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest):]


def _status(path: Path) -> os.stat_result | None:
    """Of what a path leads to, None if nothing is there."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _check_folder(folder: Path, path: Path) -> None:
    """Say which folder is missing, rather than that a file is."""
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {str(folder)!r}: make it first", str(path))


def _clean(folder: Path) -> None:
    """Remove what processes of this machine left beside their targets when they died; once a process and folder."""
    with _cleaning:
        if folder in _cleaned:
            return
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                match = _PART.fullmatch(entry.name)
                if match and not _lives(int(match[1])):
                    with contextlib.suppress(OSError):
                        if entry.is_dir(follow_symlinks=False):
                            shutil.rmtree(entry.path, ignore_errors=True)
                        else:
                            os.unlink(entry.path)
        _cleaned.add(folder)


def _lives(process: int) -> bool:
    """Whether a process that left a file is there; this one has written nothing here yet: its number is an old one."""
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _replace(target: Path, content: bytes, mode: int | None) -> None:
    """Put a whole file at the target; ``mode`` is that of the file which was there."""
    if mode is None and _write_nameless(target, content, None):
        _sync_folder(target.parent)
        return
    part = _part(target.parent)
    try:
        if not _write_nameless(part, content, mode):
            flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0)
            _fill(os.open(part, flags, 0o666), content, mode)
        os.replace(part, target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def _write_nameless(name: Path, content: bytes, mode: int | None) -> bool:
    """Write a file that gets its name when it is whole; False where the name is taken, or the system cannot."""
    if not hasattr(os, "O_TMPFILE"):
        return False
    try:
        descriptor = os.open(name.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
    except OSError as error:
        if error.errno in (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT):
            return False
        raise
    # a second number of the same file, as the first is closed when it is full
    again = os.dup(descriptor)
    try:
        _fill(descriptor, content, mode)
        # src_dir_fd, though without meaning here, has Python call linkat, which follows the link of /proc
        os.link(f"/proc/self/fd/{again}", name, src_dir_fd=again, follow_symlinks=True)
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.EXDEV, errno.EPERM, errno.ENOENT, errno.EOPNOTSUPP):
            return False
        raise
    finally:
        os.close(again)
    return True


def _fill(descriptor: int, content: bytes, mode: int | None) -> None:
    """Write, make it last, and close."""
    try:
        if mode is not None and os.chmod in os.supports_fd:
            os.chmod(descriptor, mode)
        _write_all(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    """Make a new name last; systems and file systems that cannot are left alone."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


_log = logging.getLogger(__name__)
_MODULE = "numba.core.caching"
_ROOT = str(Path(__file__).parents[0]) + os.sep
#: stands for no place at all
_NOWHERE = os.path.join(os.devnull, "adaptmg-kernels")


def install() -> None:
    """Have numba do so; when it is loaded, since adaptmg does not load it before it is needed."""
    if _MODULE in sys.modules:
        _mend(sys.modules[_MODULE])
    elif not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


class _Finder(importlib.abc.MetaPathFinder):
    """Mends the one module when it is imported."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != _MODULE:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                run(module)
                _mend(module)

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _mend(caching: ModuleType) -> None:
    """Change the cache of functions; a numba that is built otherwise is left alone."""
    cache = getattr(caching, "FunctionCache", None)
    locators = getattr(getattr(caching, "CacheImpl", getattr(caching, "_CacheImpl", None)), "_locator_classes", None)
    base = next((getattr(caching, name) for name in ("UserProvidedCacheLocator", "_UserProvidedCacheLocator")
                 if hasattr(caching, name)), None)
    if cache is None or locators is None or base is None or getattr(cache, "mended_by_adaptmg", False):
        return
    cache.load_overload = _tolerant(cache.load_overload, "read", "compiled anew", _forget)
    cache.save_overload = _tolerant(cache.save_overload, "written", "compiled again in the next process")
    cache.mended_by_adaptmg = True
    locators.append(_locator(base))


def _tolerant(method: Callable[..., Any], done: str, outcome: str,
              after: Callable[[Any], None] | None = None) -> Callable[..., Any]:
    """A method of a cache that, for kernels of adaptmg, logs what goes wrong and goes on without."""
    def tolerant(self: Any, *arguments: Any) -> Any:
        function = getattr(self, "_py_func", None)
        if not getattr(function, "__module__", "").startswith("adaptmg."):
            return method(self, *arguments)
        if self.cache_path.startswith(_NOWHERE):
            return None
        try:
            return method(self, *arguments)
        except Exception as error:  # whatever a damaged pickle or a full disk raises
            _log.warning("the cache of the kernel %s in %s cannot be %s (%s: %s): it is %s",
                         function.__qualname__, self.cache_path, done, type(error).__name__, error, outcome)
            if after is not None:
                after(self)
            return None

    return tolerant


def _forget(cache: Any) -> None:
    """Remove the index of a function, so that what is compiled now can be kept under a new one."""
    try:
        os.unlink(cache._cache_file._index_path)
    except (OSError, AttributeError):
        return


def _locator(base: type) -> type:
    """A class of locators, of numba's kind, for kernels of adaptmg that no other locator has a place for."""
    class TemporaryLocator(base):  # type: ignore[misc, valid-type]
        """Points into the directory of temporary files."""

        def __init__(self, function: Any, file: str) -> None:
            super().__init__(function, file)
            self._cache_path = os.path.join(_temporary(), self.get_suitable_cache_subpath(file))

        @classmethod
        def from_function(cls, function: Any, file: str) -> Any:
            # without a check that it can be written: numba would refuse to compile
            return cls(function, file) if file.startswith(_ROOT) else None

    return TemporaryLocator


@lru_cache(maxsize=1)
def _temporary() -> str:
    """A directory of this user alone, as compiled code is run from it; _NOWHERE if none can be made."""
    try:
        place = Path(tempfile.gettempdir(), f"adaptmg-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}")
        place.mkdir(mode=0o700, exist_ok=True)
        found = place.lstat()
        if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "getuid") and (found.st_uid != os.getuid()
                                                                          or stat.S_IMODE(found.st_mode) & 0o077)):
            place = Path(tempfile.mkdtemp(prefix="adaptmg-kernels-"))
        tempfile.TemporaryFile(dir=place).close()
    except OSError as error:
        _log.warning("compiled kernels are not kept, as nothing can be written (%s): set NUMBA_CACHE_DIR to a "
                     "directory that can", error)
        return _NOWHERE
    _log.warning("compiled kernels are kept in %s, as neither the package nor the home directory can be written: set "
                 "NUMBA_CACHE_DIR to keep them elsewhere", place)
    return str(place)
