"""Do the tests see a change of the code? Random mutants of modules against the tests next to them.

    python tests/campaigns/mutants.py [--count N] [--first SEED] [--out DIR] [MODULE ...]

A mutant is one change of one place: another comparison, another number, another sign, a statement
left out, two arguments exchanged. Places in messages, annotations and decorators are not changed.
Each seed draws a module (default: those of solver, multigrid, smoother, discrete and transfer), a
place and a change; the tests run on a copy of the package until one fails: those in the folder of
the module that name it and those elsewhere that import it, in a process of their own, then the
others there, those of agreement and evolution, of the other four folders and of hostile inputs. A
mutant that no test fails survives. Exit code 1 if more than 12 % survive."""

from __future__ import annotations

import argparse
import ast
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("solver", "multigrid", "smoother", "discrete", "transfer")
#: seconds after which a mutant counts as killed: all tests take less, also on a busy machine; and
#: those of the processor, which a loop without end reaches earlier
LIMIT_S, PROCESSOR_S = 3600, 600
#: a mutant of a table that doubles until all fits took 14 GB, B
MEMORY = 8 << 30
#: share of mutants that may survive
MAY_SURVIVE = 0.12

COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
#: decorators of functions that numba compiles, or inlines into those of other modules
KERNELS = ("@kernel", "@inner_kernel", "@in_loop")
#: calls in which the order of arguments changes nothing
COMMUTATIVE = ("max", "min", "np.maximum", "np.minimum")
SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}


@dataclass(frozen=True)
class Mutant:
    """A text in place of the source of a node."""

    node: ast.expr | ast.stmt
    text: str
    kind: str


def children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the children of a node that a mutant may change."""
    hidden: list[ast.AST] = []
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        hidden += node.decorator_list
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        hidden += [node.returns] if node.returns else []
    if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation is not None:
        hidden.append(node.annotation)
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("reshape"):
        # every negative length stands for what is left
        hidden += [size for size in node.args if ast.unparse(size) == "-1"]
    for child in ast.iter_child_nodes(node):
        if child not in hidden:
            yield child


def places(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and those below it, without messages and texts."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.FunctionDef) and node.name in ("__repr__", "__str__", "_repr_html_"):
        return
    yield node
    for child in children(node):
        yield from places(child)


def with_operator(node: ast.expr, operator: str) -> str:
    """Return the source of a binary node with another operator."""
    left, right = (
        (node.left, node.comparators[0])
        if isinstance(node, ast.Compare)
        else (node.left, node.right)
    )
    return f"(({ast.unparse(left)}) {operator} ({ast.unparse(right)}))"


def mutants_of(node: ast.AST) -> Iterator[Mutant]:
    """Yield the mutants at one node."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield Mutant(node, with_operator(node, COMPARISONS[type(node.ops[0])]), "comparison")
    if isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        yield Mutant(node, with_operator(node, SIGNS[type(node.op)]), "sign")
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield Mutant(node, f"({ast.unparse(node.operand)})", "sign")
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        value = node.value
        other = 2 * value + (1 if isinstance(value, int) else 0.1 * (value == 0))
        yield Mutant(node, f"({other!r})", "number")
    is_call = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if is_call or isinstance(node, ast.AugAssign):
        yield Mutant(node, "pass", "statement left out")
    is_ordered = isinstance(node, ast.Call) and ast.unparse(node.func) not in COMMUTATIVE
    if isinstance(node, ast.Call) and is_ordered and len(node.args) > 1:
        first, second = node.args[0], node.args[1]
        if not isinstance(first, ast.Starred) and not isinstance(second, ast.Starred):
            exchanged = [second, first, *node.args[2:]]
            call = ast.Call(node.func, exchanged, node.keywords)
            if ast.dump(first) != ast.dump(second):
                yield Mutant(node, f"({ast.unparse(call)})", "arguments exchanged")


def drawn(module: Path, rng: np.random.Generator) -> Mutant:
    """Return a mutant of a module: each kind is as likely as every other one."""
    everything = [one for node in places(ast.parse(module.read_text())) for one in mutants_of(node)]
    kind = rng.choice(sorted({one.kind for one in everything}))
    of_kind = [one for one in everything if one.kind == kind]
    return of_kind[int(rng.integers(len(of_kind)))]


def replaced(source: str, mutant: Mutant) -> str:
    """Return the source with the text of a mutant in the place of its node."""
    lines = source.encode().splitlines(keepends=True)
    node = mutant.node
    starts = np.concatenate([[0], np.cumsum([len(line) for line in lines])])
    begin = starts[node.lineno - 1] + node.col_offset
    end = starts[node.end_lineno - 1] + node.end_col_offset
    whole = source.encode()
    return (whole[:begin] + mutant.text.encode() + whole[end:]).decode()


def with_its_code(package: Path, module: Path) -> set[Path]:
    """Return the modules whose compiled kernels may contain code of a module: it, and modules of
    kernels that import it, directly or through others."""
    sources = {path: path.read_text() for path in package.rglob("*.py")}
    kernels = {path for path, text in sources.items() if any(word in text for word in KERNELS)}
    found: set[Path] = set()
    new = {module}
    while new:
        found |= new
        stems = "|".join(path.stem for path in new)
        imports = re.compile(rf"import .*\b({stems})\b|\b({stems}) import")
        new = {path for path in kernels - found if imports.search(sources[path])}
    return found


def killed(module: str, mutant: Mutant) -> bool:
    """Return whether a test fails on a copy of the package with a mutant."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("adaptmg", "tests", "studies"):
            shutil.copytree(ROOT / name, copy / name)
        shutil.copy(ROOT / "pyproject.toml", copy)
        path = copy / module
        path.write_text(replaced(path.read_text(), mutant))
        # what numba has stored of callers does not see the change
        for caller in with_its_code(copy / "adaptmg", path):
            for cached in (caller.parent / "__pycache__").glob(f"{caller.stem}.*.nbi"):
                cached.unlink()
        stem = Path(module).stem
        imported = module.removesuffix(".py").replace("/", ".")
        own_folder = Path(module).parts[1]
        folders = dict.fromkeys((own_folder, "agreement", "evolution", *FOLDERS, "hostile"))
        tests = [
            path
            for name in folders
            for path in sorted(
                (copy / "tests" / name).rglob("test_*.py"), key=lambda path: path.stat().st_size
            )
        ]
        in_folder = copy / "tests" / own_folder
        near = [
            path
            for path in sorted(
                (copy / "tests").rglob("test_*.py"),
                key=lambda path: (stem not in path.name, path.stat().st_size),
            )
            if (stem if path.is_relative_to(in_folder) else imported)
            in path.name + path.read_text()
        ]
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
        environment = {**os.environ, "PYTHONPATH": str(copy), "MPLBACKEND": "Agg"}
        for part in filter(None, (near, [path for path in tests if path not in near])):
            try:
                done = subprocess.run(
                    [*command, *map(str, part)],
                    cwd=copy,
                    env=environment,
                    capture_output=True,
                    timeout=LIMIT_S,
                )
            except subprocess.TimeoutExpired:
                return True
            if done.returncode:
                return True
        return False


def measured(seed: int, modules: list[str]) -> dict:
    """Draw a mutant and run the tests; return the row of the table."""
    rng = np.random.default_rng(seed)
    module = modules[int(rng.integers(len(modules)))]
    mutant = drawn(ROOT / module, rng)
    begin = time.monotonic()
    dead = killed(module, mutant)
    return {
        "seed": seed,
        "place": f"{module}:{mutant.node.lineno}",
        "kind": mutant.kind,
        "before": " ".join(ast.unparse(mutant.node).split())[:60],
        "after": mutant.text[:60],
        "killed": dead,
        "seconds": round(time.monotonic() - begin),
    }


def default_modules() -> list[str]:
    """Return the modules of the folders whose numerics the claims rest on."""
    found = [path for folder in FOLDERS for path in (ROOT / "adaptmg" / folder).glob("*.py")]
    return sorted(str(path.relative_to(ROOT)) for path in found if path.name != "__init__.py")


def main() -> None:
    """Run the campaign and print what survives."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="default: of five folders")
    parser.add_argument("--count", type=int, default=150, metavar="N", help="default: %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR")
    asked = parser.parse_args()
    modules = asked.modules or default_modules()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
    rows = []
    for seed in range(asked.first, asked.first + asked.count):
        row = measured(seed, modules)
        rows.append(row)
        word = "killed" if row["killed"] else "SURVIVES"
        change = f"{row['before']}  ->  {row['after']}"
        print(f"seed {seed}: {word} {row['place']} {change}", file=sys.stderr, flush=True)
    table = pd.DataFrame(rows)
    asked.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(asked.out / "mutants.csv", index=False)
    print(table.groupby("kind")["killed"].agg(["size", "sum"]).to_string())
    alive = table[~table["killed"]]
    print(alive[["place", "kind", "before", "after"]].to_string(index=False))
    share = len(alive) / len(table)
    print(f"{len(table)} mutants, {100 * (1 - share):.0f} % killed; {asked.out / 'mutants.csv'}")
    raise SystemExit(1 if share > MAY_SURVIVE else 0)


if __name__ == "__main__":
    main()
