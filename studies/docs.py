"""Build the documentation: HTML pages that open offline, search and formulas included.

    python studies/docs.py [--quick] [--out DIR]

Sources: docstrings of adaptmg, pages in studies/docs, tutorials in studies/tutorials (scripts, run
while building), tables in data/measured (written by studies). Needs the packages of ``pip install
-e ".[docs]"``."""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from reproduce import read_measured

import adaptmg as am

ROOT = Path(__file__).resolve().parent.parent
LAWS = ("Frictionless", "Tresca", "Coulomb", "StateLaw", "NormalCompliance", "problem.Law")
DOMAINS = (
    "Rectangle",
    "Circle",
    "Polygon",
    "Outline",
    "Box",
    "Ball",
    "Cylinder",
    "Extrusion",
    "Revolution",
    "StepFile",
    "Cut",
    "Fuse",
    "Common",
    "Moved",
    "Assembly",
    "problem.Domain",
)
RESULTS = ("Result", "Status", "NotConverged", "Certificate", "PathResult", "OPEN", "SLIP", "STICK")
#: pages of the reference: title, first sentence, modules whose names they show
TASKS = {
    "pose": (
        "Pose a problem",
        "Bodies, materials, contact, supports and loads, in m and Pa.",
        ("problem",),
    ),
    "domains": ("Domains", "Shapes of bodies, and how they are combined.", ()),
    "laws": ("Friction laws", "What bounds the tangential traction.", ()),
    "grids": (
        "Grids",
        "Hierarchies, coarsest level first, and their meshes.",
        ("hierarchy", "level", "mesh"),
    ),
    "transfers": ("Transfers", "Prolongations between meshes, nested or not.", ("transfer",)),
    "solve": (
        "Solve",
        "Methods and their parts. Bare matrices are posed here, too.",
        ("solver", "evolution", "multigrid", "smoother", "discrete", "_threads"),
    ),
    "results": (
        "Results",
        "What a solve returns or raises: fields, contact quantities, forces, the certificate.",
        (),
    ),
    "adapt": ("Adapt", "The adaptive loop: indicators, goals, marks and engines.", ("estimate",)),
    "study": ("Study", "A function and a design, to a durable store, to a table.", ("study",)),
    "plot": ("Plot", "Pictures; every function returns a matplotlib figure.", ("plot", "_units")),
    "export": ("Export", "Files for ParaView and PETSc, HTML reports.", ("export",)),
    "cases": ("Cases", "Ready problems; their reference values are on :doc:`/cases`.", ("cases",)),
}


def main() -> int:
    """Command line; exit code 1 where Sphinx warns."""
    parser = argparse.ArgumentParser(
        description=str(__doc__).split("\n")[0],
        epilog="example: python studies/docs.py --out /tmp/docs",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/docs"),
        metavar="DIR",
        help="default: results/docs",
    )
    parser.add_argument(
        "--quick", action="store_true", help="show tutorials without running them: no pictures"
    )
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        source = write_sources(Path(folder) / "source")
        code = subprocess.run(
            [
                sys.executable,
                "-m",
                "sphinx",
                "-W",
                "--keep-going",
                "-n",
                *([] if sys.stderr.isatty() else ["-q"]),  # else Sphinx shows its progress
                "-j",
                "auto",
                "-b",
                "html",
                "-d",
                str(Path(folder) / "doctrees"),
                str(source),
                str(out),
            ],
            check=False,
            env=os.environ | {"QUICK_DOCS": "1"} if arguments.quick else None,
        ).returncode
    if not code:
        print(f"documentation: {out / 'index.html'}")
    return 1 if code else 0


def write_sources(source: Path) -> Path:
    """Copy pages, tutorials and the picture; write the pages that are made of the package and of
    measured tables."""
    shutil.copytree(ROOT / "studies" / "docs", source)
    shutil.copytree(
        ROOT / "studies" / "tutorials",
        source / "scripts",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    shutil.copy(ROOT / "data" / "pictures" / "overview.png", source)
    write_reference(source / "api")
    (source / "cases.rst").write_text(cases_page(), encoding="utf-8")
    (source / "measured.rst").write_text(
        measured_page(ROOT / "data" / "measured"), encoding="utf-8"
    )
    return source


def public_names() -> dict[str, list[str]]:
    """Every public name, by the page of the reference that shows it."""
    pages: dict[str, list[str]] = {task: [] for task in TASKS}
    task_of = {module: task for task, (_, _, modules) in TASKS.items() for module in modules}
    homes = {
        name.name: node.module
        for node in ast.parse(Path(am.__file__).with_suffix(".pyi").read_text()).body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    every = [(home.split(".")[0], name) for name, home in sorted(homes.items()) if home]
    every += [
        (module, f"{module}.{name}")
        for module, home in homes.items()
        if not home
        for name in getattr(getattr(am, module), "__all__", ())
        if name not in homes
    ]
    for module, name in every:
        page = task_of[module]
        if name in LAWS:
            page = "laws"
        elif name in DOMAINS:
            page = "domains"
        elif name in RESULTS or name.startswith("solver."):
            page = "results"
        pages[page].append(name)
    return pages


def write_reference(folder: Path) -> None:
    """Write the pages of the reference, by task."""
    folder.mkdir()
    index = _title("API by task") + (
        "\nEvery public name has a page with its arguments, units and errors, an example (protocols: the "
        "methods that an object of yours offers), and links to the how-tos and tutorials that use it. "
        "Scripts begin with ``import adaptmg as am``; names without a module are in ``am``. "
        "A solve goes through these pages from top to bottom.\n"
    )
    tree = "\n.. toctree::\n   :hidden:\n\n"
    for task, names in public_names().items():
        title, sentence, _ = TASKS[task]
        shown = ", ".join(f":obj:`~adaptmg.{name}`" for name in names[:6])
        more = f" and {len(names) - 6} more" if len(names) > 6 else ""
        index += f"\n:doc:`{task}`\n   {sentence} {shown}{more}.\n"
        tree += f"   {task}\n"
        page = (
            f"{_title(title)}\n{sentence}\n\n.. currentmodule:: adaptmg\n\n"
            ".. autosummary::\n   :toctree: names\n   :nosignatures:\n\n"
        )
        (folder / f"{task}.rst").write_text(
            page + "".join(f"   {name}\n" for name in names), encoding="utf-8"
        )
    (folder / "index.rst").write_text(index + tree, encoding="utf-8")


def cases_page() -> str:
    """A table of the cases, and their reference values with sources."""
    page = _title("Cases") + (
        "\nProblems with defaults for all arguments; the values are those of the defaults, in SI "
        "units. ``am.cases.NAME().reference`` holds them.\n"
    )
    listed = {**am.cases.CASES, **am.cases.FROM_PYTHON}
    cases = {name: (case.description, case.function()) for name, case in listed.items()}
    page += _table(
        ["case", "what it is"],
        [[f":func:`~adaptmg.cases.{name}`", text] for name, (text, _) in cases.items()],
    )
    for name, (_, problem) in cases.items():
        rows = [[f"``{key}``", text] for key, text in _flat(problem.reference)]
        page += (
            f"\n{name}\n{'-' * len(name)}\n" + _table(["reference", "value"], rows) if rows else ""
        )
    return page


def _flat(reference: Mapping[str, object], before: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of a nested mapping; a mapping to numbers is one value."""
    for key, value in reference.items():
        if isinstance(value, Mapping) and any(
            isinstance(item, (str, Mapping)) for item in value.values()
        ):
            yield from _flat(value, f"{before}{key}: ")
        else:
            yield f"{before}{key}", _shown(value)


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{key} {_shown(item)}" for key, item in value.items())
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))})"
    if isinstance(value, str):
        return value.replace("|", r"\|").replace("*", r"\*")
    if isinstance(value, (bool, int, float)):
        return f"{value:.7g}" if isinstance(value, float) else str(value)
    return (
        "a function" if callable(value) else f":class:`~adaptmg.cases.{type(value).__name__}`"
    )  # a closed form


def measured_page(folder: Path) -> str:
    """The tables that studies have written into data/measured, with what they say."""
    page = _title("Measured") + (
        "\n``python studies/reproduce.py --record`` writes these tables. Seconds are processor "
        "seconds of one thread with compiled kernels. Work is in passes over the finest matrix; "
        "factorisations are in the seconds only. A cell with two numbers has a slash between them, "
        "and the text above the table says what they are. The line above a table names the command, "
        "the commit, the date and, since they are recorded, the machine.\n\n"
        "**Errors.** A true error of an iterate is its distance to the converged solution on the same "
        "mesh, relative, in the energy norm. The error of a mesh is the distance to a closed form or to "
        "the solution on a much finer mesh, in the same norm. Half-width and peak of Hertz's and "
        "Cattaneo's contact are those of the half ellipse that fits the nodal pressures within 0.8 "
        "half-widths best, against the closed form. Other quantities are compared with their "
        "reference values: a force, a width, a stress intensity.\n"
    )
    for file in sorted(folder.glob("*.csv")):
        (title, *notes), frame = read_measured(file)
        page += f"\n{title}\n{'-' * len(title)}\n\n" + "\n\n".join(notes) + "\n"
        page += _table(list(frame.columns), frame.to_numpy().tolist())
    return page


def _title(text: str) -> str:
    return f"{text}\n{'=' * len(text)}\n"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A list-table of reStructuredText."""
    text = "\n.. list-table::\n   :header-rows: 1\n\n"
    for row in (head, *rows):
        text += "".join(
            f"   {'*' if column == 0 else ' '} - {cell}\n" for column, cell in enumerate(row)
        )
    return text


if __name__ == "__main__":
    raise SystemExit(main())
