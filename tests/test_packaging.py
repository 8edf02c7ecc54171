"""The package as it is installed and as it lies in the repository."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import stub

import adaptmg

REPOSITORY = Path(__file__).parents[1]
SETTINGS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETTINGS["project"]
TOP_LEVEL = {"pyproject.toml", "adaptmg", "studies", "tests", "data", "README.md", "LICENSE"}


def _files() -> list[Path]:
    """Files of the repository that git tracks or would track; without git, all but caches."""
    listed = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=REPOSITORY,
                            capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git repository")
    return [path for path in (REPOSITORY / name for name in listed.stdout.splitlines()) if path.is_file()]


def test_the_version_is_one():
    assert PROJECT["version"] == adaptmg.__version__


def test_there_is_no_lock_file_and_nothing_else_at_the_top():
    top = {path.relative_to(REPOSITORY).parts[0] for path in _files()}
    assert {name for name in top if not name.startswith(".")} <= TOP_LEVEL
    pinned = re.compile(r"\.lock$|(requirements|constraints).*\.txt$")
    assert not [path.name for path in _files() if pinned.search(path.name)]


def test_type_checkers_see_the_names_there_are():
    assert stub.PATH.read_text(encoding="utf-8") == stub.stub(), "write it again: python tests/helpers/stub.py"


def test_dependencies_have_lower_bounds_and_no_upper_ones():
    extras = [r for group in PROJECT["optional-dependencies"].values() for r in group]
    for requirement in [*PROJECT["dependencies"], *extras]:
        assert re.fullmatch(r"[A-Za-z0-9_.-]+>=[0-9][0-9.]*", requirement), requirement


def test_no_file_names_a_package_index_or_a_path_of_a_machine():
    # spelt in pieces, or this file would be found
    index = "|".join(["index" + "-url", "find" + "-links", "pypi" + r"\.(org|io)", "files.python" + "hosted"])
    home = "|".join(["/ho" + "me/", "/ro" + "ot/", "/wo" + "rk/", "C:" + r"\\Users"])
    for path in _files():
        if path.suffix in (".py", ".toml", ".md", ".txt", ".cfg", ".sh", ".yml", "") and path.stat().st_size < 1e6:
            text = path.read_text(encoding="utf-8")
            found = re.search(f"({index})|({home})", text)
            assert not found, f"{path.relative_to(REPOSITORY)}: {found[0]!r}"


def test_the_command_is_installed_where_the_project_says():
    module, _, name = PROJECT["scripts"]["adaptmg"].partition(":")
    assert callable(getattr(__import__(module, fromlist=[name]), name))


@pytest.mark.parametrize("name", [n for n in adaptmg.__all__ if n != "__version__"])
def test_every_public_name_is_there_and_documented(name):
    value = getattr(adaptmg, name)
    if name.isupper() and isinstance(value, int):
        return
    assert len((value.__doc__ or "").strip()) > 10, f"adaptmg.{name} has no docstring"
    assert not (value.__doc__ or "").startswith(f"{name}("), f"adaptmg.{name} has only the docstring dataclass makes"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = adaptmg.nothing
    assert set(adaptmg.__all__) <= set(dir(adaptmg))


def test_importing_is_light():
    code = "import sys, adaptmg; sys.stdout.write(' '.join(m for m in sys.argv[1:] if m in sys.modules))"
    heavy = ["ngsolve", "netgen", "pandas", "matplotlib", "numba", "pyamg", "scipy"]
    done = subprocess.run([sys.executable, "-c", code, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout == ""


def test_python_without_docstrings_is_refused_by_name():
    done = subprocess.run([sys.executable, "-OO", "-c", "import adaptmg"], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].startswith("ImportError: adaptmg cannot run under 'python -OO'")
