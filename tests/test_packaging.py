"""The package as it is installed and as it lies in the repository; .ci/run installs it and calls
its command."""

import doctest
import importlib
import inspect
import io
import pkgutil
import pydoc
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import adaptmg

REPOSITORY = Path(__file__).parents[1]
SETTINGS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))


def _files() -> list[Path]:
    """Files of the repository that git tracks or would track, relative to it."""
    names = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    if names.returncode:
        pytest.skip("not a git repository")
    return [Path(name) for name in names.stdout.splitlines() if (REPOSITORY / name).is_file()]


def test_top_level():
    assert SETTINGS["project"]["dynamic"] == ["version"]
    assert adaptmg.__version__ == version("adaptmg")
    top = {path.parts[0] for path in _files()}
    assert {name for name in top if not name.startswith(".")} <= {
        "pyproject.toml",
        "adaptmg",
        "studies",
        "tests",
        "data",
        "README.md",
        "LICENSE",
    }


def test_no_file_names_a_package_index_or_a_path_of_a_machine():
    # in pieces, because this file is searched too
    index = "|".join(
        ["index" + "-url", "find" + "-links", "pypi" + r"\.(org|io)", "files.python" + "hosted"]
    )
    home = "|".join(["/ho" + "me/", "/ro" + "ot/", "/wo" + "rk/", "C:" + r"\\Users"])
    for path in _files():
        if path.suffix in (".py", ".toml", ".md", ".txt", ".cfg", ".sh", ".yml", ""):
            match = re.search(
                f"({index})|({home})", (REPOSITORY / path).read_text(encoding="utf-8")
            )
            assert not match, f"{path}: {match[0]!r}"


def test_public_names_resolve_and_are_documented():
    for name in set(dir(adaptmg)) - {"OPEN", "SLIP", "STICK"}:
        text = getattr(adaptmg, name).__doc__ or ""
        assert len(text) > 10 and not text.startswith(f"{name}("), name
    with pytest.raises(AttributeError, match="No adaptmg attribute nothing"):
        _ = adaptmg.nothing


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (
            "import adaptmg",
            ["ngsolve", "netgen", "pandas", "matplotlib", "numba", "pyamg", "scipy"],
        ),
        (
            "import adaptmg.cli, adaptmg.study as study; study.Study(lambda n: {'m': n}, {'n': [1]}).run()",
            ["ngsolve", "netgen", "dask", "distributed"],
        ),
        (
            "import adaptmg as am; am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4)))",
            ["ngsolve", "netgen", "pandas", "matplotlib", "scipy.optimize", "scipy.spatial"],
        ),
    ],
)
def test_libraries_are_loaded_where_they_are_needed(code, heavy):
    found = "import sys; sys.stdout.write(' '.join(m for m in sys.argv[1:] if m in sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", f"{code}; {found}", *heavy],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == ""


def _public(modules: Sequence[str] = ("cases", "export", "mesh", "plot", "study")) -> dict:
    """Public names with what they stand for: those of the package, and those of the submodules that
    users name."""
    names = {name: getattr(adaptmg, name) for name in dir(adaptmg)}
    for module in modules:
        names |= {
            f"{module}.{name}": getattr(getattr(adaptmg, module), name)
            for name in getattr(adaptmg, module).__all__
        }
    return {
        name: thing
        for name, thing in names.items()
        if inspect.isclass(thing) or inspect.isfunction(thing)
    }


#: protocols, and what functions return whose page has the example
WITHOUT_EXAMPLE = {
    "cases.TransitionField",
    "estimate.EnergyError",
    "estimate.Reference",
    "mesh.onto_domain",
    "problem.Domain",
    "problem.Inelastic",
    "problem.Law",
    "smoother.ContactState",
    "smoother.Smoother",
    "transfer.Location",
    "transfer.Supports",
    "transfer.Transfer",
}


def test_every_public_name_has_an_example_that_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner(verbose=False)
    without, report = set(), io.StringIO()
    ingredients = (
        "discrete",
        "estimate",
        "multigrid",
        "problem",
        "smoother",
        "solver",
        "transfer",
    )
    result_parts = {"Result.": adaptmg.Result.__mro__[1]}  # its base, whose methods are public
    for name, thing in (_public(ingredients) | _public() | result_parts).items():
        globs = vars(sys.modules[thing.__module__]) | {"am": adaptmg, "np": np}
        # those of methods too
        for found in finder.find(thing, name, globs=globs):
            if found.examples:
                runner.run(found, out=report.write)
                # a page is as wide: 100 columns with the prompt
                lines = [line for example in found.examples for line in example.source.split("\n")]
                assert max(map(len, lines)) <= 96, (found.name, max(lines, key=len))
            elif found.name == name and name not in result_parts:
                without.add(found.name)
    assert not runner.failures, report.getvalue()
    assert without == WITHOUT_EXAMPLE


def test_modules_list_their_names():
    modules = {
        name: getattr(adaptmg, name)
        for name in dir(adaptmg)
        if inspect.ismodule(getattr(adaptmg, name))
    }
    for name, module in modules.items():
        listed = [entry for entry in dir(module) if not entry.startswith("_")]
        assert set(listed) == set(module.__all__), name
        assert all(hasattr(module, entry) for entry in listed)
    # the names of the package by task, on three screens
    text = pydoc.plain(pydoc.render_doc(adaptmg))
    head = text[: text.index("\nPACKAGE CONTENTS")] if "\nPACKAGE CONTENTS" in text else text
    missing = {
        name
        for name in dir(adaptmg)
        if not name.startswith("_") and not re.search(rf"\b{name}\b", head)
    }
    assert not missing and len(text.splitlines()) <= 75, (missing, len(text.splitlines()))


def test_functions_that_read_packages_can_be_sent_to_workers():
    """lazy_loader changes the type of a package with a module and a public name that are called
    alike, and cloudpickle does not know that type."""
    cloudpickle = pytest.importorskip("cloudpickle")
    for found in pkgutil.iter_modules(adaptmg.__path__, "adaptmg."):
        if found.ispkg:
            package = importlib.import_module(found.name)
            assert cloudpickle.loads(cloudpickle.dumps(package)) is package
