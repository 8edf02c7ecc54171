"""The README and the documentation: examples run, what is named exists, every public name has a
page."""

import importlib.util
import inspect
import logging
import re
import shutil
import sys
import textwrap
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest
import step_assembly
from gmsh_file import write
from netgen.occ import Box, Cylinder, Pnt, Z

import adaptmg as am

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted((ROOT / "studies" / "docs").rglob("*.rst"))


@pytest.fixture
def listed_names(monkeypatch):
    """Every name on a page of the reference."""
    monkeypatch.syspath_prepend(ROOT / "studies")
    spec = importlib.util.spec_from_file_location("build_docs", ROOT / "studies" / "docs.py")
    docs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(docs)
    return [name for names in docs.public_names().values() for name in names]


def test_every_public_name_has_a_page_and_stands_in_a_guide(listed_names):
    modules = [name for name in dir(am) if inspect.ismodule(getattr(am, name))]
    public = [*set(dir(am)) - set(modules)] + [
        f"{module}.{name}"
        for module in modules
        for name in getattr(am, module).__all__
        if name not in dir(am)
    ]
    assert sorted(listed_names) == sorted(public)
    guides = [page for page in PAGES if page.parent.name in ("howto", "theory")]
    guides += (ROOT / "studies" / "tutorials").glob("*.py")
    text = "\n".join(page.read_text(encoding="utf-8") for page in guides)
    for name in public:
        last = name.rpartition(".")[2]
        assert re.search(rf"\b(?:am|adaptmg)\.(?:\w+\.)?{last}\b|``(?:\w+\.)?{last}\b", text), name


def returned(thing):
    """Names of classes that annotations of a public function or class say it returns or holds."""
    if not inspect.isclass(thing):
        return re.findall(r"\b[A-Z]\w+", str(inspect.signature(thing).return_annotation))
    texts = [str(text) for text in getattr(thing, "__annotations__", {}).values()]
    for name, part in vars(thing).items():
        function = getattr(part, "fget", None) or getattr(part, "func", None)
        function = function or getattr(part, "__func__", part)
        if not name.startswith("_") and inspect.isfunction(function):
            texts.append(str(inspect.signature(function).return_annotation))
    return re.findall(r"\b[A-Z]\w+", " ".join(texts))


#: classes that objects hand to each other inside the package
INSIDE = {
    "Anisotropy",
    "Arc",
    "BlockRows",
    "Computed",
    "Condensed",
    "Coupling",
    "EnergyTerms",
    "Factorised",
    "Functional",
    "Inclined",
    "Layer",
    "Moduli",
    "Outcome",
    "PlasticState",
    "Posed",
    "Preconditioned",
    "ProjectedRun",
    "Refinement",
    "Segment",
    "Slit",
    "SolidDomain",
    "SparseEquations",
    "TruncatedRun",
    "Volumes",
}


def test_what_public_names_return_has_a_page(listed_names):
    pages = {name.rpartition(".")[2] for name in listed_names}
    missing = set()
    for name in listed_names:
        thing = attrgetter(name)(am)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            names = vars(sys.modules[thing.__module__])
            missing |= {
                f"{name}: {kind}"
                for kind in returned(thing)
                if inspect.isclass(names.get(kind))
                and names[kind].__module__.startswith("adaptmg.")
                and not getattr(names[kind], "_is_protocol", False)
                and kind not in pages | INSIDE
            }
    assert missing == set()


def blocks(page):
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"^\.\. code-block:: python\n\n((?:   .*\n|\n)*)", text, re.MULTILINE)
    return [textwrap.dedent(block) for block in found]


@pytest.mark.slow
def test_examples_of_the_readme_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(compile(block, "README.md", "exec"), names)
    assert names["result"].status is am.Status.CONVERGED and names["result"].residual < 1e-7
    assert names["step"].outcome.startswith("max_nodes")
    assert (
        am.Result.load("run.npz").cycles == names["result"].cycles
        and (tmp_path / "contact.png").exists()
    )


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """What the pages of the documentation take as known: a matrix from another code, files of
    meshes, an assembly; and the folder of the files."""
    folder = tmp_path_factory.mktemp("given")
    problem = am.cases.greco_bar()
    meshes = [am.mesh.structured(problem.domain, n) for n in (16, 32)]
    shapes = {"base": Box(Pnt(0, 0, 0), Pnt(30, 20, 8)), "pad": Cylinder(Pnt(0, 0, 0), Z, 5, 6)}
    step_assembly.write(
        folder / "press.step",
        shapes,
        [("base", "base:1", (0, 0, 0)), ("pad", "left", (8, 10, 8)), ("pad", "right", (22, 10, 8))],
    )
    fine = am.discretise(problem, meshes[1])
    for name, mesh in zip(("coarse", "fine"), meshes, strict=True):
        write(
            folder / f"{name}.msh",
            replace(mesh, bodies=("bar",)),
            keep=slice(0, 3, 2),
        )
    contact = fine.contact
    return folder, {
        "problem": problem,
        "A": fine.matrix,
        "b": fine.load,
        "fixed": fine.fixed,
        "x": fine.coordinates,
        "i": contact.nodes,
        "n": contact.normals,
        "g": contact.gaps,
    }


def test_short_answers_are_right():
    problem = am.cases.greco_bar()
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    names = {
        "am": am,
        "grids": grids,
        "problem": problem,
        "other": am.cases.greco_bar(law=am.Coulomb(0.3)),
        "mesh": grids.finest.mesh,
        "result": am.solve(grids),
        "steps": list(am.adapt(problem, max_nodes=200)),
        "x": 0.01,
        "y": 0.02,
        "points": [(0.01, 0.02)],
        "size": am.SizeNear([(0, 0)], size=2e-3),
        "shank": am.Rectangle(width=1, height=2),
        "head": am.Rectangle(width=3, height=1, origin=(-1, 2)),
    }
    answers = (ROOT / "studies" / "docs" / "howto" / "questions.rst").read_text(encoding="utf-8")
    expressions = re.findall(r"``((?:am|grids|result)\.[^`]*)``", answers)
    assert len(expressions) > 15
    for expression in expressions:
        eval(
            expression.replace('"boundary"', '"bottom"').replace(
                "am.set_threads(2)", "am.set_threads(1)"
            ),
            names,
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page)], ids=lambda page: page.stem
)
def test_examples_of_the_documentation_run(page, given, tmp_path, monkeypatch, caplog):
    folder, known = given
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    names = dict(known)
    caplog.set_level(logging.NOTSET, "adaptmg")
    with matplotlib.rc_context():  # a page shows how to change settings
        for block in blocks(page):
            # a tenth of the 400 time steps
            code = compile(block.replace("end=4e-3", "end=4e-4"), str(page), "exec")
            if page.stem != "cluster":  # the lines there need a scheduler
                exec(code, names)
    plt.close("all")
    assert "result" not in names or names["result"].status.ok


def test_code_in_pages_is_at_most_100_columns_wide():
    for page in PAGES:
        code = re.findall(
            r"^\.\. code-block:: (?:python|text)\n\n((?:   .*\n|\n)*)",
            page.read_text(encoding="utf-8"),
            re.MULTILINE,
        )
        for line in textwrap.dedent("".join(code)).splitlines():
            assert len(line) <= 100, (page.name, line)


def test_what_the_readme_names_exists():
    for path in re.findall(r"\]\(([^)]*)\)", README) + re.findall(r"(studies/\w+\.py)", README):
        assert (ROOT / path).exists(), path
    assert len(README.splitlines()) <= 130 and max(map(len, README.splitlines())) <= 140
