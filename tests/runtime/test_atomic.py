"""The one writer: files are whole or not there, with the permissions of others, and nothing is left
beside them."""

import os
import signal
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from adaptmg._files import read_bytes, waiting_folder, write_bytes
from adaptmg._machine import process_name


@pytest.fixture
def mask():
    old = os.umask(0o027)
    yield 0o027
    os.umask(old)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_new_files_have_the_umask_and_old_ones_their_permissions(tmp_path, mask):
    write_bytes(tmp_path / "a", b"1")
    assert mode(tmp_path / "a") == 0o640
    (tmp_path / "a").chmod(0o604)
    write_bytes(tmp_path / "a", b"22")
    assert mode(tmp_path / "a") == 0o604 and (tmp_path / "a").read_bytes() == b"22"
    assert names(tmp_path) == ["a"]


def test_links_pipes_and_standard_output_are_written_through(tmp_path):
    (tmp_path / "there").mkdir()
    target, link, dangling = tmp_path / "there" / "file", tmp_path / "link", tmp_path / "dangling"
    target.write_bytes(b"old")
    link.symlink_to(target)
    dangling.symlink_to(Path("there", "new"))
    write_bytes(link, b"new")
    write_bytes(dangling, b"made")
    assert link.is_symlink() and target.read_bytes() == b"new"
    assert dangling.is_symlink() and (tmp_path / "there" / "new").read_bytes() == b"made"
    write_bytes(os.devnull, b"gone")
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)
    pipe, found = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: found.append(pipe.read_bytes()))
    reader.start()
    write_bytes(pipe, b"x" * 200_000)
    reader.join(10)
    assert found == [b"x" * 200_000] and stat.S_ISFIFO(pipe.stat().st_mode)
    assert names(tmp_path) == ["dangling", "link", "pipe", "there"]


@pytest.mark.parametrize("failing", ["replace", "fsync"])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, failing):
    target = tmp_path / ("n" * 255)  # the longest name
    for content in (b"1", b"old"):
        write_bytes(target, content)
    with pytest.raises(KeyError), waiting_folder(tmp_path) as waiting:
        (waiting / "x").write_bytes(b"")
        raise KeyError
    monkeypatch.setattr(
        os, failing, lambda *arguments: (_ for _ in ()).throw(OSError(28, "disk full"))
    )
    with pytest.raises(OSError, match="disk full"):
        write_bytes(target, b"new")
    monkeypatch.setattr(os, "access", lambda path, how: False)
    with pytest.raises(PermissionError, match="write-protected"):
        write_bytes(target, b"new")
    assert names(tmp_path) == [target.name] and target.read_bytes() == b"old"


def test_a_kill_leaves_whole_files(tmp_path):
    code = (
        "import sys\nfrom pathlib import Path\nfrom adaptmg._files import write_bytes\n"
        "sys.stdout.write('x'); sys.stdout.flush()\n"
        "for k in range(10**9):\n"
        "    write_bytes(Path(sys.argv[1], f'f{k % 3}'), bytes([k % 256]) * 10**6)\n"
    )
    for k in range(4):
        with subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE
        ) as writer:
            writer.stdout.read(1)
            time.sleep(0.02 + 0.02 * k)
            writer.send_signal(signal.SIGKILL)
        for file in tmp_path.glob("f?"):
            content = file.read_bytes()
            assert len(content) == 10**6 and len(set(content)) == 1
    # what they left goes when the next process writes there, not what a living one writes
    other = f".adaptmg-{process_name(os.getppid())}-1.part"
    for name in (other, f".adaptmg-{process_name(os.getpid())}-2.part", ".adaptmg-mine.part"):
        (tmp_path / name).touch()
    code = (
        "import sys\nfrom adaptmg._files import waiting_folder\n"
        "with waiting_folder(sys.argv[1]) as folder:\n    input()"
    )
    for _ in range(2):
        with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdin=-1) as waiting:
            while len(left := [name for name in names(tmp_path) if str(waiting.pid) in name]) != 1:
                time.sleep(0.01)
            waiting.kill()
        assert len(names(tmp_path)) == 7 and left[0] in names(tmp_path)
    write_bytes(tmp_path / "f0", b"")
    assert names(tmp_path) == sorted(
        [
            other,
            f".adaptmg-{process_name(os.getpid())}-2.part",
            ".adaptmg-mine.part",
            "f0",
            "f1",
            "f2",
        ]
    )


@pytest.mark.parametrize("path", ["a folder", "a pipe", "/dev/zero", "/dev/null", "too large"])
def test_only_regular_files_of_a_bounded_size_are_opened(tmp_path, path):
    os.mkfifo(tmp_path / "a pipe")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "too large").write_bytes(b"x" * 11)
    with pytest.raises(
        ValueError, match=f"{path} must (be a file|have at most 10 bytes, it has 11)"
    ):
        read_bytes(tmp_path / path, 10)
    assert read_bytes(tmp_path / "too large", 11) == b"x" * 11


def test_many_threads_may_write_one_file(tmp_path):
    threads = [
        threading.Thread(target=write_bytes, args=(tmp_path / "a", bytes([k]) * 10_000))
        for k in range(8)
    ]
    for act in (threading.Thread.start, threading.Thread.join):
        for thread in threads:
            act(thread)
    assert len(set((tmp_path / "a").read_bytes())) == 1 and names(tmp_path) == ["a"]
