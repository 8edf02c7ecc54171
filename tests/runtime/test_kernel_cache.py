"""Kernels run where their compiled code can be neither kept nor read back; each case in a process of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import adaptmg

ROOT = Path(adaptmg.__file__).parent
RUN = ("import logging; logging.basicConfig(format='%(message)s')\n"
       "import numpy as np\nfrom adaptmg.geometry import search as morton\n"
       "assert len(morton.morton_order(np.random.default_rng(1).random((5, 2)))) == 5\n"
       "assert morton.__file__.startswith({folder!r}), morton.__file__\n")


@pytest.fixture
def package(tmp_path):
    """A copy of what the kernel needs, without any cache; a function that runs it in a new process."""
    copy = tmp_path / "src" / "adaptmg"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def run(before: str = "", **environment: str) -> str:
        done = subprocess.run([sys.executable, "-B", "-c", before + RUN.format(folder=str(tmp_path))],
                              capture_output=True, text=True, timeout=120, cwd=tmp_path,
                              env={k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
                              | {"PYTHONPATH": str(copy.parent)} | environment)
        assert done.returncode == 0, done.stderr
        return done.stderr

    return copy / "geometry", run


def _nothing_writable(folder: Path) -> dict[str, str]:
    # a file where numba would make its directory: not even root can write there
    (folder / "__pycache__").write_text("a file")
    return {"HOME": os.devnull, "XDG_CACHE_HOME": os.path.join(os.devnull, "cache")}


def test_kernels_go_to_a_directory_of_this_user_where_no_other_can_be_written(package, tmp_path):
    folder, run = package
    (temporary := tmp_path / "temporary").mkdir()
    said = run(**_nothing_writable(folder), TMPDIR=str(temporary))
    (place,) = temporary.iterdir()
    assert f"compiled kernels are kept in {place}" in said and said.count("\n") == 1
    assert list(place.rglob("*.nbc")) and not place.stat().st_mode & 0o077
    # one that others could write to is not trusted
    place.chmod(0o777)
    run(TMPDIR=str(temporary), **_nothing_writable(folder))
    assert len(list(temporary.iterdir())) == 2


def test_kernels_run_where_nothing_can_be_written_at_all(package):
    folder, run = package
    said = run("import tempfile; tempfile.tempdir = '/dev/null'\n", **_nothing_writable(folder))
    assert "compiled kernels are not kept" in said and said.count("\n") == 1


def test_compiling_is_announced_once_and_a_damaged_cache_is_compiled_again(package):
    """On a terminal as it is, else in the log; not for kept kernels."""
    folder, run = package
    terminal = "import sys; sys.stderr.isatty = lambda: True\n"
    log = "import logging; logging.basicConfig(format='%(message)s', level=logging.INFO)\n"
    assert run(terminal).startswith("adaptmg: compiling kernels (first use")
    assert run(terminal) == ""
    cache = folder / "__pycache__"
    files = sorted(cache.glob("search.*.nb[ic]"))
    assert {file.suffix for file in files} == {".nbi", ".nbc"}
    damages = (lambda b: b"", lambda b: b[:len(b) // 2], lambda b: b"\0junk" * 100)
    # of every other kernel the index, of the others the code: behind a damaged index no code is read
    kernels = sorted({file.name.partition(".py")[0] for file in files})
    damaged = [file for k, name in enumerate(kernels) for file in files
               if file.name.startswith(f"{name}.") and file.suffix == (".nbi", ".nbc")[k % 2]]
    assert {file.suffix for file in damaged} == {".nbi", ".nbc"}
    for k, file in enumerate(damaged):
        file.write_bytes(damages[k % 3](file.read_bytes()))
    said = run(log)
    assert said.count("cannot be read") >= len(damaged) / 2  # what is inlined is not asked for by itself
    assert said.count("compiling kernels (first use") == 1 and "adaptmg: compiling" not in said
    assert run() == "", "what is compiled again is kept"


def test_a_cache_that_cannot_be_written_is_left_out(package):
    _, run = package
    full = ("import numba.core.caching as c\n"
            "def full(*a): raise OSError(28, 'No space left on device')\n"
            "c.IndexDataCacheFile._save_data = full\n")
    said = run(full)
    assert "No space left on device" in said and "cannot be written" in said
    assert run() == ""


def test_a_kernel_from_the_cache_is_called_without_a_compiler_and_linked_by_kernels_compiled_later(tmp_path):
    (tmp_path / "pair.py").write_text(
        "from adaptmg._runtime import kernel\n\n"
        "@kernel\ndef root(x):\n    return 1.0 if x <= 0.0 else x * root(x - 1.0)\n\n"
        "@kernel\ndef twice(x):\n    return 2.0 * root(x)\n")

    def run(*lines: str) -> None:
        done = subprocess.run([sys.executable, "-B", "-c", "\n".join(("import sys, pair", *lines))], cwd=tmp_path,
                              env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_NUM_THREADS": "1",
                                                "PYTHONPATH": os.pathsep.join((str(ROOT.parent), str(tmp_path)))},
                              capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr

    run("assert pair.root(3.0) == 6.0")
    listed = "'numba.cpython.cmathimpl' in sys.modules"  # what numba can compile
    run("assert pair.root(4.0) == 24.0", f"assert not {listed}", "assert pair.root.stats.cache_hits",
        "assert pair.twice(4.0) == 48.0", f"assert {listed} and pair.twice.stats.cache_misses")
    run("assert pair.twice(3.0) == 12.0", "assert pair.twice.stats.cache_hits and not pair.root.stats.cache_misses",
        f"assert not {listed}")
