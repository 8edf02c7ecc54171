"""The layers of the package: a layer imports only from layers above it; who may load NGSolve; nobody prints.

Imports inside functions and under ``TYPE_CHECKING`` count too: what a signature names is a dependency.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import adaptmg

ROOT = Path(adaptmg.__file__).parent
LAYERS = ("runtime", "problem", "geometry", "discrete_input", "contact_nodes", "exchange", "coupling", "discrete",
          "mesh", "discretisation", "transfer", ("level", "hierarchy_input"), "meshed_levels", "levels", "hierarchy",
          "smoother", "multigrid", "solver", "estimate", "cases", "study", "plot", "export", "cli")
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in ([names] if isinstance(names, str) else names)}
MAY_USE_NGSOLVE = {"mesh", "discretisation", "export"}
FILES = sorted(ROOT.rglob("*.py"))


def layer_of(file: Path) -> str:
    name = file.relative_to(ROOT).parts[0].removesuffix(".py")
    return "cli" if name == "__main__" else name


def imported_modules(tree: ast.AST, package: str) -> Iterator[tuple[int, str]]:
    """Line and full name of everything imported, at any depth; ``package`` resolves relative imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[:len(package.split(".")) - node.level + 1]
                base = ".".join([*parents, *([base] if base else [])])
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            argument = node.args[0] if node.args else None
            if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                yield node.lineno, argument.value


def target_layer(name: str) -> str | None:
    """Layer of an imported name, None outside adaptmg; a public name of adaptmg belongs where it is defined."""
    parts = name.split(".")
    if parts[0] != "adaptmg":
        return None
    if len(parts) > 1 and parts[1] in adaptmg._HOME:
        parts = adaptmg._HOME[parts[1]].split(".")
    return parts[1] if len(parts) > 1 else "adaptmg"


def violations(source: str, layer: str, package: str) -> list[str]:
    """What a module of ``layer`` does that it may not."""
    tree = ast.parse(source)
    found = []
    uses = {alias.asname or alias.name for node in ast.walk(tree) if isinstance(node, ast.Import)
            for alias in node.names if alias.name == "adaptmg"}
    for line, name in imported_modules(tree, package):
        target = target_layer(name)
        top = name.split(".")[0]
        if top in ("ngsolve", "netgen") and layer not in MAY_USE_NGSOLVE:
            found.append(f"{line}: {layer} imports {top}")
        if target in RANK and target != layer and RANK[target] >= RANK[layer]:
            found.append(f"{line}: {layer} imports {name}, of the layer {target} below it")
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in uses:
            target = target_layer(f"adaptmg.{node.attr}")
            if target in RANK and target != layer and RANK[target] >= RANK[layer]:
                found.append(f"{node.lineno}: {layer} uses adaptmg.{node.attr}, of the layer {target} below it")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
            found.append(f"{node.lineno}: prints")
    return found


def circle(sources: dict[str, str]) -> list[str]:
    """Modules that import each other in a circle, also inside functions and for types; empty if there is none."""
    graph = {}
    for name, source in sources.items():
        wanted = [found for _, found in imported_modules(ast.parse(source), name.rpartition(".")[0])]
        # a name out of a module, or a module
        known = {found if found in sources else found.rpartition(".")[0] for found in wanted}
        graph[name] = {found for found in known if found in sources and found != name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_circle_of_imports_inside_a_layer_or_across():
    sources = {".".join(["adaptmg", *file.relative_to(ROOT).with_suffix("").parts]).removesuffix(".__init__"):
               file.read_text(encoding="utf-8") for file in FILES}
    assert circle(sources) == []


@pytest.mark.parametrize("back", ["from a.x import X", "import a.x", "def f():\n    from a import x",
                                  "if TYPE_CHECKING:\n    from a.x import X", "from .x import X"])
def test_each_kind_of_circle_is_seen(back):
    assert set(circle({"a": "", "a.x": "from a.y import Y", "a.y": "from a.z import Z", "a.z": back})) \
        == {"a.x", "a.y", "a.z"}
    assert not circle({"a": "", "a.x": "from a.y import Y", "a.y": "from a.z import Z", "a.z": "import b.x"})


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.relative_to(ROOT).as_posix())
def test_a_module_imports_only_from_layers_above(file):
    if file == ROOT / "__init__.py":
        return
    package = ".".join(["adaptmg", *file.relative_to(ROOT).parent.parts])
    assert layer_of(file) in RANK, f"{file} belongs to no layer: put it into one, or add the layer"
    assert not violations(file.read_text(encoding="utf-8"), layer_of(file), package)


@pytest.mark.parametrize(("source", "layer"), [
    ("from adaptmg.solver.record import Run", "transfer"),
    ("import adaptmg.plot.style", "solver"),
    ("def f():\n    from adaptmg.multigrid import Cycle", "smoother"),
    ("if TYPE_CHECKING:\n    from adaptmg.hierarchy import Level", "transfer"),
    ("from ..solver import solve", "mesh"),
    ("from adaptmg import solve", "smoother"),
    ("import adaptmg as am\nam.solve(1)", "multigrid"),
    ("from adaptmg import export", "plot"),
    ("import importlib\nimportlib.import_module('adaptmg.study.study')", "cases"),
    ("def f():\n    import ngsolve", "solver"),
    ("from netgen.geom2d import SplineGeometry", "problem"),
    ("print('x')", "cli"),
])
def test_each_kind_of_violation_is_seen(source, layer):
    assert violations(source, layer, f"adaptmg.{layer}")


@pytest.mark.parametrize(("source", "layer"), [
    ("from adaptmg import _checks as checks", "solver"),
    ("from . import arrays", "mesh"),
    ("import ngsolve", "mesh"),
    ("import adaptmg as am\nam.solve(1)", "study"),
    ("import numpy", "problem"),
])
def test_what_is_allowed_is_let_pass(source, layer):
    assert not violations(source, layer, f"adaptmg.{layer}")


def _loaded(statement: str) -> set[str]:
    """Top-level modules loaded by a statement in a fresh interpreter."""
    code = f"import sys\n{statement}\nsys.stdout.write(' '.join(sorted({{n.split('.')[0] for n in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("module", ["adaptmg", "adaptmg.problem", "adaptmg.discrete.problem", "adaptmg.transfer",
                                    "adaptmg.mesh", "adaptmg.hierarchy", "adaptmg.solver.solve", "adaptmg.cases",
                                    "adaptmg.cli"])
def test_importing_does_not_load_ngsolve(module):
    assert not {"ngsolve", "netgen"} & _loaded(f"import {module}")


def test_the_check_of_loaded_modules_can_fail():
    assert "sqlite3" in _loaded("import sqlite3") and "sqlite3" not in _loaded("pass")
