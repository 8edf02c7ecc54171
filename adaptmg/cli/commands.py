"""The commands and their options. Heavy modules are imported inside them, so that ``--help`` is
instant.

The options of ``solve`` and ``adapt`` are made from signatures and types by
:mod:`adaptmg.cli.build`."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import logging
import os
import re
import sys
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

from adaptmg import __version__
from adaptmg._text import printable

if TYPE_CHECKING:
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec

    from adaptmg.study import Study
    from adaptmg.study.store import Record

_STORED = "finished runs are stored, the same command goes on"
#: runs that --dry-run shows
_SHOWN = 20
#: sections of settings whose keys are the options of a command
_SECTIONS = {"solve": ("case", "hierarchy", "solver"), "adapt": ("case", "adapt")}


class _Parser(argparse.ArgumentParser):
    """A parser that raises ValueError for bad input."""

    def error(self, message: str) -> None:  # type: ignore[override]
        raise ValueError(f"{message} (see '{self.prog} --help')")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; SystemExit with 0, 1 (failed or not converged), 2 (bad input) or 130
    (Ctrl-C)."""
    texts = list(sys.argv[1:] if arguments is None else arguments)
    with _errors(texts):
        parser = _parser(texts[0] if texts else "")
        parsed, unknown = parser.parse_known_args(texts or ["--help"])
        if unknown:
            from adaptmg._checks import suggestion

            name = unknown[0].partition("=")[0]
            raise ValueError(
                f"there is no option {name}{suggestion(name, parsed.options)}: 'adaptmg {texts[0]} "
                "--help' lists them"
            )
        raise SystemExit(parsed.run(parsed))


def _parser(command: str) -> _Parser:
    """Return the parser of all commands. Options that need the classes of the package, which load
    slowly, are added for ``command`` only."""
    parser = _Parser(
        "adaptmg",
        description="Multigrid for frictional contact on adaptively refined meshes.",
        epilog="Example: adaptmg solve greco_bar. Exit codes: 0 done, 1 failed or not converged, 2 bad "
        "input, 130 Ctrl-C.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version", action="version", version=f"adaptmg {__version__}", help="print the version"
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def made(
        run: Callable[[Namespace], int | None], purpose: str, example: str, *more: str
    ) -> Callable[..., object]:
        """Add a command, which ``run`` does, and return the function that adds its options."""
        name = run.__name__[1:]  # without the underscore
        parser = commands.add_parser(
            name,
            help=purpose,
            epilog=f"Example: adaptmg {name} {example}",
            allow_abbrev=False,
            description=" ".join([f"{purpose[0].upper()}{purpose[1:]}.", *more]),
        )
        if command == name in _SECTIONS:
            parser.usage = f"adaptmg {name} CASE [options]"
            _add_settings(parser, name)
        parser.set_defaults(run=run, options=parser._option_string_actions)
        return parser.add_argument

    add = made(_cases, "list the benchmark cases, or explain one", "dovetail")
    add(
        "case",
        metavar="CASE",
        nargs="?",
        help="explain this one: arguments with types and defaults, loads",
    )
    _add_json(add)
    add = made(
        _solve,
        "solve a case and print the result",
        "greco_bar --sizes 10e-3,5e-3,2.5e-3 --contact-ratio 4 "
        "--transfer pseudo-l2 --friction 0.3 --set young=7e10 --out results/bar",
        "Without options grids follow the case. Lists have commas.",
    )
    add(
        "--out",
        metavar="FOLDER",
        type=Path,
        help="folder for the result (.npz), pictures and a .vtu file",
    )
    add("--dry-run", action="store_true", help="forecast nodes, memory and seconds, solve nothing")
    _add_json(add)
    add = made(
        _adapt,
        "solve a case on meshes that follow the error, until a limit is reached: a line a step",
        "upset_block --max-nodes 20000 --engine bisect --out results/upset",
    )
    add(
        "--out",
        metavar="FOLDER",
        type=Path,
        help="folder for the last result (.npz), pictures and a .vtu file",
    )
    add(
        "--store",
        metavar="FOLDER",
        type=Path,
        help="folder that keeps every step; an interrupted loop goes on there",
    )
    _add_json(add)
    _add_studies(made)
    made(
        _warm,
        "compile the kernels in one go, so that later solves need not wait for them",
        "",
        "Each kernel is compiled once on a machine and stored. All take about a minute, less on several processors.",
    )
    return parser


def _add_json(add: Callable[..., object]) -> None:
    """Add the option --json."""
    add("--json", action="store_true", help="print JSON")


def _add_studies(made: Callable[..., Callable[..., object]]) -> None:
    """Add the commands of studies and their stores."""
    add = made(
        _study,
        "run the study of a Python script and print its table",
        "my.py --workers 4",
        "The script makes an am.Study, or has run and parameters. Runs that are stored are not computed again. "
        "Exit code 0: all runs done and converged; 1: a run failed or did not converge (column outcome).",
    )
    add("file", metavar="FILE.py", type=Path, help="script")
    add(
        "--workers", metavar="N", type=int, help="processes on this machine (default: this process)"
    )
    add("--scheduler", metavar="ADDRESS", help="a dask scheduler instead, such as tcp://host:8786")
    add(
        "--limit-s", metavar="SECONDS", type=float, help="stop a run after this time; needs workers"
    )
    add(
        "--memory-limit",
        metavar="BYTES",
        type=float,
        help="stop a run that holds more memory; needs --workers",
    )
    add("--store", metavar="STORE", type=Path, help="SQLite file (default: results/FILE.sqlite)")
    add("--dry-run", action="store_true", help="show the runs without computing them")
    add("--retry-failed", action="store_true", help="run again what failed")
    add("--rerun", action="store_true", help="run everything again")
    add("-q", "--quiet", action="store_true", help="no progress and no table: errors alone")
    _add_json(add)
    add = made(
        _report,
        "write a page that opens offline: pictures of results, all runs, those that failed",
        "results/friction.sqlite --result cycles --to friction.html",
    )
    add("store", metavar="STORE", type=Path, help="SQLite file of studies")
    add("--study", metavar="NAME", help="name of a study in the store (default: the only one)")
    add(
        "--result",
        metavar="COLUMN",
        action="append",
        help="column to draw; several times (default: two that vary)",
    )
    add(
        "--unit",
        metavar="COLUMN=UNIT",
        action="append",
        default=[],
        help="unit of a column, such as peak=Pa; several times",
    )
    add(
        "--to",
        metavar="FILE.html",
        type=Path,
        help="file to write (default: next to the store, named as the study)",
    )


def _add_settings(parser: _Parser, command: str) -> None:
    """Add the case, and an option for each key of the sections of a command; of a key of two sections
    for the first: --limit is that of Tresca's law, not that of the paper's correction."""
    from adaptmg.cli.build import PURPOSE, sections

    parser.add_argument("case", metavar="CASE", help="name of a case, see 'adaptmg cases'")
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="an argument of the case, see 'adaptmg cases CASE'; several times",
    )
    seen = {"case"}
    for section in _SECTIONS[command]:
        group = parser.add_argument_group(f"{section}: {PURPOSE[section]}")
        for key, about in sections()[section].items():
            if key in seen:
                continue
            seen.add(key)
            # two keys have a further name
            keys = {"method": ("solver", key), "shape": ("cycle", key)}.get(key, (key,))
            names = [f"--{name.replace('_', '-')}" for name in keys]
            default = f", default {about.default}" if about.default else ""
            group.add_argument(
                *names,
                dest=f"{section}.{key}",
                default=argparse.SUPPRESS,
                metavar="VALUE",
                help=f"{about.values}{default}".replace("%", "%%"),
            )


def _settings(parsed: Namespace) -> dict[str, dict[str, object]]:
    """Return the settings that the options give, by section."""
    from adaptmg.cli import build

    texts = {name: text for name, text in vars(parsed).items() if "." in name}
    texts |= {f"case.{name}": value for name, value in _pairs("--set", parsed.set).items()}
    return build.from_texts(parsed.case, texts, adaptive=parsed.run is _adapt)


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Return names and values of an option that is given as NAME=VALUE."""
    pairs = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not value:
            raise ValueError(f"{option} must be NAME=VALUE, got {printable(ascii(text))}")
        pairs[name] = value
    return pairs


def _as_json(value: object) -> str:
    """Return a value as JSON."""
    return json.dumps(value, indent=2, allow_nan=False)


def _cases(parsed: Namespace) -> None:
    """List the cases, or explain one."""
    from adaptmg.cases import CASES, FROM_PYTHON

    if parsed.case is not None:
        from adaptmg.cli import build

        name = parsed.case
        _say(_as_json(build.case_facts(name)) if parsed.json else build.about_case(name))
    elif parsed.json:
        rows = [
            {"name": name, "description": case.description, "call": case.call}
            for name, case in {**CASES, **FROM_PYTHON}.items()
        ]
        _say(_as_json(rows))
    else:
        width = max(map(len, [*CASES, *FROM_PYTHON]))
        for title, cases in (
            ("", CASES),
            ("\nfrom Python, see 'adaptmg cases NAME':\n", FROM_PYTHON),
        ):
            rows = [f"{name:<{width}}  {case.description}" for name, case in cases.items()]
            _say(title + "\n".join(rows))


def _solve(parsed: Namespace) -> int:
    """Solve a case, and return the exit code."""
    from adaptmg.cli import build, output

    settings = _settings(parsed)
    if parsed.dry_run:
        costs = build.forecast(settings)
        _say(_as_json(costs._asdict()) if parsed.json else str(costs))
        return 0
    folder = output.folder(parsed.out)
    with output.watched() as callback:
        result, grids, _ = build.solved(settings, callback)
    files = output.write(folder, result, grids, [])
    if parsed.json:
        _say(_as_json(output.summary(result, files)))
    else:
        _say("\n".join([str(grids), "", str(result), *(f"wrote {file}" for file in files)]))
    if not result.status.ok:
        _say(f"adaptmg: not converged ({result.status.name}): {result.status.value}", err=True)
    return int(not result.status.ok)


def _adapt(parsed: Namespace) -> None:
    """Solve a case on meshes that follow the error."""
    from adaptmg.cli import build, output

    settings = _settings(parsed)
    folder = output.folder(parsed.out)
    waiting: list[str] = []
    with output.watched() as progress:
        # lines would run into the bar: they wait until it ends
        say = waiting.append if parsed.json or progress is not None else _say
        result, grids, steps = build.solved(
            settings, progress, on_step=lambda step: say(repr(step)), store=parsed.store
        )
    files = output.write(folder, result, grids, steps)
    if parsed.json:
        _say(_as_json(output.loop_summary(steps, files)))
    else:
        _say(
            "\n".join(
                [*waiting, steps[-1].outcome, "", str(result), *(f"wrote {file}" for file in files)]
            )
        )


def _warm(parsed: Namespace) -> None:
    """Compile all kernels."""
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    from rich.console import Console
    from rich.progress import track

    from adaptmg._machine import processors
    from adaptmg.cli.warm import STEPS, solve_step

    console = Console(stderr=True)
    with ProcessPoolExecutor(
        min(processors(), len(STEPS)),
        mp_context=get_context("spawn"),
        initializer=warnings.simplefilter,  # what is solved is not the point
        initargs=("ignore",),
    ) as pool:
        names = {pool.submit(solve_step, name): name for name in STEPS}
        for task in track(
            as_completed(names),
            "compiling",
            total=len(names),
            console=console,
            disable=not console.is_terminal,
        ):
            console.print(names[task])
            task.result()


def _study(parsed: Namespace) -> int:
    """Run the study of a script, and return the exit code."""
    from adaptmg.cli.output import finite, logged
    from adaptmg.study import as_text

    study = _study_of(parsed.file, parsed.store)
    if not parsed.dry_run:
        options = {
            name: getattr(parsed, name)
            for name in ("workers", "scheduler", "limit_s", "memory_limit", "rerun", "retry_failed")
        }
        # a line for each run; on a terminal, which shows a bar, of failures only
        line_for_each = sys.stderr and not (parsed.quiet or sys.stderr.isatty())
        level = logging.INFO if line_for_each else logging.WARNING
        with logged("adaptmg.study", level, logging.StreamHandler()):
            study.run(progress=False if parsed.quiet else None, **options)
    table = study.table(details=parsed.json)
    status = study.status()
    columns = table.attrs["columns"]
    if parsed.json:
        rows = {} if parsed.dry_run else {"rows": finite(table.to_dict("records"))}
        about = {"study": study.name, "runs": status.total, **dataclasses.asdict(status)}
        _say(_as_json(about | rows))
    elif parsed.dry_run:
        shown = table[[*study.parameters, columns["status"]]].head(_SHOWN)
        _say(f"{as_text(shown)}\n\n{study!r}\n{status!r}")
    elif not parsed.quiet:
        shown = table.drop(columns=columns["error"])
        _say(f"{as_text(shown, units={columns['seconds']: 's'})}\n\n{status!r}")
    if parsed.dry_run:
        return 0
    not_converged = 0
    # a run returns outcome=result.status by convention (how-to on studies)
    if "outcome" in table:
        not_converged = int((table["outcome"].dropna() != "CONVERGED").sum())
    counts = {
        "failed: --retry-failed runs them again": status.failed,
        "did not converge, see the column outcome": not_converged,
    }
    for text, count in counts.items():
        if count:
            _say(f"adaptmg: {count} of {len(table)} runs {text}", err=True)
    return int(any(counts.values()))


def _study_of(path: Path, store: Path | None) -> Study:
    """Import a script, and return the study that it makes, or that of its ``run`` and
    ``parameters`` (with ``fixed`` and ``depends`` where it has them), which is stored in
    results/SCRIPT.sqlite. What stands below ``if __name__ == "__main__"`` does not run."""
    import cloudpickle

    from adaptmg import _checks as checks
    from adaptmg._files import file_size
    from adaptmg.study import Study

    file = checks.file_path("FILE", path)
    if file.suffix != ".py":
        raise ValueError(
            f"FILE must be a Python script that makes an am.Study, got {checks.shown(os.fspath(path))}"
        )
    # only its check that there is a file
    file_size("FILE", file)
    # as Python does for a script, so that it can import files next to it
    sys.path.insert(0, os.fspath(file.resolve().parent))
    # a file whose name ends with .py has a spec and a loader
    spec = cast("ModuleSpec", importlib.util.spec_from_file_location(file.stem, file))
    loader = cast("Loader", spec.loader)
    module = sys.modules[file.stem] = importlib.util.module_from_spec(spec)
    # workers cannot import it, and it may run its study on workers while it is imported
    cloudpickle.register_pickle_by_value(module)
    try:
        loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    by_identity = {id(value): value for value in vars(module).values() if isinstance(value, Study)}
    studies = list(by_identity.values())
    if len(studies) == 1:
        if store is not None:
            raise ValueError(
                "--store belongs to scripts with run and parameters: this one makes its am.Study itself"
            )
        return studies[0]
    run = getattr(module, "run", None)
    parameters = getattr(module, "parameters", None)
    if studies or run is None or parameters is None:
        raise ValueError(
            f"{file} must make one am.Study, or have run and parameters; it makes {len(studies)} studies"
        )
    default_store = Path("results", f"{file.stem}.sqlite")
    return Study(
        run,
        parameters,
        default_store if store is None else store,
        name=file.stem,
        fixed=getattr(module, "fixed", None),
        depends=getattr(module, "depends", None),
    )


def _report(parsed: Namespace) -> None:
    """Write a page on a study in a store."""
    from adaptmg import _checks as checks
    from adaptmg._files import file_size, write_bytes
    from adaptmg.export import study_report
    from adaptmg.study.store import Store
    from adaptmg.study.tables import frame

    # only its check that there is a file
    file_size("STORE", checks.file_path("STORE", parsed.store))
    store = Store(parsed.store)
    names = store.studies()
    if parsed.study not in names and (parsed.study is not None or len(names) != 1):
        raise ValueError(
            f"give --study, one of {', '.join(names) or 'none, as the store has no runs'}"
            f"{checks.suggestion(parsed.study or '', names)}"
        )
    name = parsed.study or names[0]
    page = parsed.store.with_name(f"{Path(name).name}.html") if parsed.to is None else parsed.to
    if page.suffix != ".html":
        raise ValueError(
            f"--to must be an HTML file, got {checks.shown(str(page))}: its table is a .csv next to it"
        )
    records = list(store.get(name).values())
    csv = page.with_suffix(".csv")
    parameters = dict.fromkeys(key for record in records for key in record.parameters)
    # parameters with the same value in all runs
    fixed = {
        key: value
        for key, value in records[0].parameters.items()
        if len(records) > 1 and len({repr(record.parameters.get(key)) for record in records}) == 1
    }
    varied = [key for key in parameters if key not in fixed]
    table = frame(varied, [(record.parameters, record, record.status) for record in records])
    table.attrs |= {"study": name, "fixed": fixed}
    study_report(
        table,
        page,
        parameters=varied,
        results=parsed.result,
        units=_pairs("--unit", parsed.unit),
        csv=csv.name,
        made=_origin(records),
    )
    write_bytes(csv, table.to_csv(index=False).encode("utf-8", "backslashreplace"))
    _say(f"wrote {page} and {csv}", err=True)


def _origin(records: Sequence[Record]) -> dict[str, str]:
    """Return machines, commits, versions and dates of runs."""
    facts = {
        "machine": {record.machine for record in records},
        "commit": {record.commit[:12] for record in records},
        "versions of the runs": {
            ", ".join(map(" ".join, record.versions.items())) for record in records
        },
    }
    times = sorted(record.finished[:16] for record in records)  # up to the minute
    # at most three of each are named
    return {name: "; ".join(sorted(texts)[:3]) for name, texts in facts.items()} | {
        "runs made": f"{times[0]} to {times[-1]} UTC"
    }


@contextmanager
def _errors(texts: Sequence[str]) -> Iterator[None]:
    """Turn errors inside a with statement into a line on standard error and an exit code; see
    :func:`main`."""
    as_json = "--json" in texts
    command = texts[0] if texts else ""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            yield
    except BrokenPipeError:  # the reader of the output has gone
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        stored = command == "study" or any(text.startswith("--store") for text in texts)
        _fail(f"interrupted{f': {_STORED}' * stored}", as_json)
        raise SystemExit(130) from None
    except (ValueError, TypeError, OSError, MemoryError, ArithmeticError, RuntimeError) as error:
        # by its name: solvers may not be loaded
        not_converged = "NotConverged" in {kind.__name__ for kind in type(error).__mro__}
        text = " ".join(_message(error).split())
        if command in _SECTIONS:  # keys of settings are options here
            text = re.sub(
                rf"\b(?:{'|'.join(_SECTIONS[command])})\.([\w.]+)",
                lambda match: f"--{match[1].replace('_', '-')}",
                text,
            )
        _fail(f"{'not converged: ' * not_converged}{text}", as_json)
        raise SystemExit(1 if not_converged else 2) from None


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Write a warning as a line; the arguments are those of ``warnings.showwarning``."""
    _say(f"adaptmg: warning: {' '.join(str(message).split())}", err=True)


def _fail(text: str, as_json: bool) -> None:
    """Write an error as a line, and as JSON where that is asked for."""
    if as_json:
        _say(json.dumps({"error": text}))
    _say(f"adaptmg: {text}", err=True)


def _message(error: Exception) -> str:
    """Return the message of an error as a user should read it: alone where it is written for users, after
    the type of the error where it is not."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.strerror}: {error.filename!r}"
    if isinstance(error, MemoryError):
        return f"not enough memory: take fewer or larger elements ({error})"
    # NotConverged has a result; importing it here would load the solvers for every message
    for_users = isinstance(error, ValueError | TypeError | OSError) or hasattr(error, "result")
    return str(error) if for_users else f"{type(error).__name__}: {error}"


def _say(text: str, err: bool = False) -> None:
    """Write a line to standard output, or to standard error, in the encoding that it takes."""
    stream = sys.stderr if err else sys.stdout
    if stream is not None:
        code = getattr(stream, "encoding", None) or "utf-8"
        stream.write(printable(text).encode(code, "backslashreplace").decode(code) + "\n")
        stream.flush()
