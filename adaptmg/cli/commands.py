"""The commands and their options. Heavy modules are imported inside them, so that ``--help`` is instant."""

from __future__ import annotations

import json
import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, TextIO

import typer

from adaptmg import __version__

__all__ = ["app", "main", "report", "runs", "study"]

# names of classes for --help, which loads none of them; a test compares these with adaptmg.cli.build
SolverName = Literal["full-multigrid", "multigrid", "single-grid", "active-set"]
LawName = Literal["frictionless", "coulomb", "tresca"]
TransferName = Literal["interpolation", "l2", "lumped-l2", "pseudo-l2", "quasi-interpolation"]
CorrectionName = Literal["truncated", "monotone", "paper"]
Shape = Literal["V", "W", "F", "complete"]
LinearName = Literal["direct", "amg"]
EngineName = Literal["remesh", "bisect"]
IndicatorName = Literal["residual", "recovery"]

# options of several commands
CaseOption = Annotated[str, typer.Argument(help="Name of a case, see 'adaptmg cases'.")]
LawOption = Annotated[LawName | None, typer.Option("--law", show_default="that of the case", help="Contact law.")]
FrictionOption = Annotated[float | None, typer.Option("--friction", help="Coefficient of Coulomb friction.")]
LimitOption = Annotated[float | None, typer.Option("--limit", help="Tresca limit, Pa.")]
SetOption = Annotated[list[str] | None, typer.Option(
    "--set", metavar="NAME=VALUE", help="Argument of the case, see 'adaptmg cases NAME'; several times.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
StoreOption = Annotated[Path, typer.Argument(help="SQLite file of studies.")]
StudyOption = Annotated[str | None, typer.Option(
    "--study", show_default="the only one", help="Name of a study in the store.")]

app = typer.Typer(pretty_exceptions_enable=False,
                  context_settings={"help_option_names": ["-h", "--help"]},
                  epilog="Example: adaptmg solve greco_bar --divisions 4,8,16,32. Exit codes: 0 done, 1 failed or not "
                         "converged, 2 bad input, 130 Ctrl-C.")


def main() -> None:
    """Entry point of the command."""
    app(prog_name="adaptmg")


@app.callback(invoke_without_command=True)
def _root(context: typer.Context,
          version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False) -> None:
    """Multigrid for frictional contact on adaptively refined, non-nested meshes."""
    if version:
        _say(f"adaptmg {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command(epilog="Example: adaptmg cases dovetail")
def cases(
    case: Annotated[str | None, typer.Argument(help="Name of a case: its arguments and boundaries.",
                                               show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """List the benchmark cases, or explain one: arguments with units and defaults, boundaries, loads."""
    with _errors(as_json):
        from adaptmg.cases import CASES

        if case is not None:
            from adaptmg.cli import explain

            _say(json.dumps(explain.case_facts(case), indent=2) if as_json else explain.about_case(case))
            return
        if as_json:
            _say(json.dumps([{"name": n, "description": found.description} for n, found in CASES.items()], indent=2))
            return
        width = max(map(len, CASES))
        for name, found in CASES.items():
            _say(f"{name:<{width}}  {found.description}")


@app.command(epilog="Example: adaptmg solve greco_bar --sizes 10e-3,5e-3,2.5e-3 --contact-ratio 4 "
                    "--transfer pseudo-l2 --friction 0.3 --set young=7e10 --out results/bar")
def solve(
    case: CaseOption,
    divisions: Annotated[str | None, typer.Option(
        show_default="4,8,16,32; 3D: 2,4,8", help="Uniform nested grids: cells a side, coarse to fine.")] = None,
    sizes: Annotated[str | None, typer.Option(
        help="Independent graded meshes instead: element sizes in m, coarse to fine.")] = None,
    contact_ratio: Annotated[float | None, typer.Option(
        show_default="1", help="With --sizes: size away from contact over size at contact.")] = None,
    transfer: Annotated[TransferName | None, typer.Option(
        show_default="interpolation", help="With --sizes: transfer between the grids.")] = None,
    law: LawOption = None,
    friction: FrictionOption = None,
    limit: LimitOption = None,
    arguments: SetOption = None,
    solver: Annotated[SolverName, typer.Option(help="Method.")] = "full-multigrid",
    correction: Annotated[CorrectionName | None, typer.Option(
        show_default="truncated", help="Multigrid: correction.")] = None,
    cycle: Annotated[Shape | None, typer.Option(
        "--cycle", "--shape", show_default="V", help="Shape of the cycle of other corrections than truncated.")] = None,
    pre: Annotated[int | None, typer.Option(show_default="2", help="Sweeps before such a correction.")] = None,
    post: Annotated[int | None, typer.Option(show_default="0", help="Sweeps after such a correction.")] = None,
    omega: Annotated[float | None, typer.Option(show_default="1", help="Relaxation of the sweeps.")] = None,
    linear: Annotated[LinearName | None, typer.Option(show_default="direct", help="Active set: linear solver.")] = None,
    rtol: Annotated[float | None, typer.Option(
        show_default="that of the method", help="Tolerance: estimated relative error in the energy norm.")] = None,
    most: Annotated[int | None, typer.Option(
        "--max-cycles", show_default="that of the method", help="Cycles, sweeps or Newton steps at most.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the result (.npz), pictures and a .vtu file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a case and print the result.

    Exit code 1 if the tolerance was not reached, 2 for bad input, 130 for Ctrl-C.
    """
    with _errors(as_json):
        from adaptmg.cli import solve_case
        from adaptmg.cli.output import watched

        folder = None if out is None else solve_case.out_folder(out)
        problem = solve_case.problem_of(case, arguments or (), law=law, friction=friction, limit=limit)
        method = solve_case.method_of(solver, correction=correction, shape=cycle, pre=pre, post=post, omega=omega,
                                      linear=linear, rtol=rtol, max_cycles=most)
        with watched(method.rtol) as callback:
            grids = solve_case.hierarchy_of(problem, divisions, sizes, contact_ratio=contact_ratio, transfer=transfer)
            result = solve_case.solved(grids, method, callback)
        files = [] if folder is None else solve_case.write(folder, problem, grids, result)
        if as_json:
            _say(json.dumps(solve_case.summary(result, files), indent=2, allow_nan=False))
        else:
            _say("\n".join([str(grids), "", str(result), *(f"wrote {file}" for file in files)]))
    if not result.status.ok:
        _say(f"adaptmg: not converged ({result.status.name}): {result.status.value}", err=True)
        raise typer.Exit(1)


@app.command(epilog="Example: adaptmg adapt upset_block --max-nodes 20000 --engine bisect --out results/upset")
def adapt(
    case: CaseOption,
    start: Annotated[float | None, typer.Option(
        show_default="an eighth of a body", help="Element size of the first mesh, m.")] = None,
    tolerance: Annotated[float | None, typer.Option(
        help="Stop at this estimate of the error, relative to the energy norm of the displacement.")] = None,
    max_nodes: Annotated[int | None, typer.Option(
        show_default="20000 if no limit is given", help="Nodes at most.")] = None,
    max_seconds: Annotated[float | None, typer.Option(help="Begin no step after this time.")] = None,
    engine: Annotated[EngineName, typer.Option(
        help="New meshes by sizes, or bisection of marked elements.")] = "remesh",
    indicator: Annotated[IndicatorName, typer.Option(help="Estimate of the error.")] = "residual",
    theta: Annotated[float, typer.Option(help="Share of the estimate whose elements are marked (bisect).")] = 0.5,
    law: LawOption = None,
    friction: FrictionOption = None,
    limit: LimitOption = None,
    arguments: SetOption = None,
    out: Annotated[Path | None, typer.Option(
        help="Directory for the last result (.npz), pictures and a .vtu file.")] = None,
    store: Annotated[Path | None, typer.Option(
        help="Directory that keeps every step; an interrupted loop goes on from there.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a case on meshes that follow the error, until a limit is reached: a line a step.

    Exit code 1 if a mesh could not be solved to its tolerance, 2 for bad input, 130 for Ctrl-C: with --store the same
    command goes on.
    """
    with _errors(as_json, "" if store is None else "finished steps are stored, the same command goes on"):
        from adaptmg.cli import solve_case
        from adaptmg.cli.output import watched_loop

        folder = None if out is None else solve_case.out_folder(out)
        problem = solve_case.problem_of(case, arguments or (), law=law, friction=friction, limit=limit)
        waiting: list[str] = []
        with watched_loop() as progress:
            # lines would run into the bar: they wait until it ends
            say = waiting.append if as_json or progress is not None else _say
            steps = solve_case.stepped(
                problem, start, {"indicator": indicator, "engine": engine, "theta": theta},
                {"tolerance": tolerance, "max_nodes": max_nodes, "max_seconds": max_seconds}, store, progress, say)
        files = [] if folder is None else solve_case.write_loop(folder, problem, steps)
        if as_json:
            _say(json.dumps(solve_case.loop_summary(steps, files), indent=2, allow_nan=False))
        else:
            last = steps[-1]
            _say("\n".join([*waiting, last.outcome, "", str(last.result), *(f"wrote {file}" for file in files)]))


@contextmanager
def _errors(as_json: bool = False, go_on: str = "") -> Iterator[None]:
    """Bad input and files that cannot be written become a line on standard error and exit code 2; Ctrl-C is 130."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            yield
    except BrokenPipeError:
        raise  # the reader of the output has gone: typer ends quietly
    except KeyboardInterrupt:
        _fail(f"interrupted{': ' * bool(go_on)}{go_on}", as_json)
        raise typer.Exit(130) from None
    except (ValueError, TypeError, OSError, MemoryError, ArithmeticError, RuntimeError) as error:
        # by its name: solvers may not be loaded
        missed = "NotConverged" in {kind.__name__ for kind in type(error).__mro__}
        _fail(f"{'not converged: ' * missed}{' '.join(_words(error).split())}", as_json)
        raise typer.Exit(1 if missed else 2) from None


def _warn(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
          line: str | None = None) -> None:
    """Print a warning as a line, without its place in Python."""
    _say(f"adaptmg: warning: {' '.join(str(message).split())}", err=True)


def _fail(text: str, as_json: bool) -> None:
    if as_json:
        _say(json.dumps({"error": text}))
    _say(f"adaptmg: {text}", err=True)


def _words(error: Exception) -> str:
    """Return the message of an exception, without numbers of the operating system."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.strerror}: {error.filename!r}"
    if isinstance(error, MemoryError):
        return f"not enough memory: take fewer or larger elements ({error})"
    plain = isinstance(error, ValueError | TypeError | OSError) or hasattr(error, "result")
    return str(error) if plain else f"{type(error).__name__}: {error}"


def _say(text: str, err: bool = False) -> None:
    """Print any text on any terminal; characters that it cannot show become codes."""
    from adaptmg._text import printable

    stream = sys.stderr if err else sys.stdout
    code = getattr(stream, "encoding", None) or "utf-8"
    typer.echo(printable(text).encode(code, "backslashreplace").decode(code), err=err)


@app.command(epilog="Example: adaptmg study --template greco_bar > my.toml, then adaptmg study my.toml --workers 4")
def study(
    file: Annotated[Path | None, typer.Argument(
        help="TOML file: --keys lists its keys, --template prints one.", metavar="FILE.toml",
        show_default=False)] = None,
    keys: Annotated[bool, typer.Option("--keys", help="List all keys and measures, with units and defaults.")] = False,
    template: Annotated[str | None, typer.Option(
        help="Print a file to begin with, for a case of 'adaptmg cases'.", metavar="CASE")] = None,
    workers: Annotated[int | None, typer.Option(
        show_default="that of the file, or this process", help="Processes on this machine.", min=1)] = None,
    scheduler: Annotated[str | None, typer.Option(
        help="Address of a dask scheduler instead, such as tcp://host:8786.")] = None,
    store: Annotated[Path | None, typer.Option(show_default="that of the file", help="SQLite file.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the runs without computing them.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run again what failed.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Run everything again.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table: errors alone.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a study and print its table.

    Runs that are stored are not computed again. Exit code 0: all runs done and converged; 1: a run failed or did not
    converge; 2: bad input; 130: Ctrl-C, the same command goes on.
    """
    with _errors(as_json, "finished runs are stored, the same command goes on"):
        if keys or template is not None:
            from adaptmg.cli import explain

            if as_json:
                _say(json.dumps(explain.key_facts() if keys else {"template": explain.template(template)}, indent=2))
            else:
                _say(explain.keys() if keys else explain.template(template))
            return
        if file is None:
            raise ValueError("give a file: adaptmg study FILE.toml; --template CASE prints one to begin with")
        from adaptmg.cli import study_file

        described = study_file.read(file)
        options = {**described.options, "rerun": rerun, "retry_failed": retry_failed}
        if workers is not None or scheduler is not None:
            options |= {"workers": workers, "scheduler": scheduler}
        study_file.check_options(described, options)
        target = described.store if store is None else store
        # a dry run writes nothing
        made = study_file.checked(described, target if not dry_run or target.exists() else None)
        if dry_run:
            _say(json.dumps(study_file.summary(made, False), indent=2) if as_json else study_file.plan(made))
            return
        if options.get("workers") is None and scheduler is None:
            study_file.warm(made)
        with _logged(quiet):
            table = made.run(progress=False if quiet else None, **options)
        if as_json:
            _say(json.dumps(study_file.summary(made, True), indent=2, allow_nan=False))
        elif not quiet:
            from adaptmg.cli.measure import units_of
            from adaptmg.cli.output import printed

            _say(printed(table.drop(columns=["error"]), made.parameters, units=units_of(table)))
            _say(f"\n{made.status()!r}\nstored in {target}")
        failed, missed = int((table["status"] == "failed").sum()), study_file.unsolved(table)
    for count, words in ((failed, "failed: --retry-failed runs them again"),
                         (missed, "did not converge, see the column outcome")):
        if count:
            _say(f"adaptmg: {count} of {len(table)} runs {words}", err=True)
    if failed or missed:
        raise typer.Exit(1)


@contextmanager
def _logged(quiet: bool) -> Iterator[None]:
    """Send the log of studies to standard error: failures only on a terminal, else a line for each run."""
    logger = logging.getLogger("adaptmg.study")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    level, spread = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if sys.stderr and not (quiet or sys.stderr.isatty()) else logging.WARNING)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = spread


@app.command(epilog="Example: adaptmg runs results/friction.sqlite --where case.friction=0.2 --where \"cycles>20\" "
                    "--to friction.csv")
def runs(
    store: StoreOption,
    study: StudyOption = None,
    status: Annotated[str | None, typer.Option(help="Only runs that are 'done' or 'failed'.")] = None,
    where: Annotated[list[str] | None, typer.Option(
        help="Only runs with NAME=VALUE, or with !=, <, <=, >, >= and a number; several times: all of them.")] = None,
    details: Annotated[bool, typer.Option("--details", help="Also tries, memory, machine, commit ...")] = False,
    limit: Annotated[int, typer.Option(help="Rows that are printed at most; JSON and files have all.", min=1)] = 50,
    to: Annotated[Path | None, typer.Option(
        help="Write all of them to a file: .csv, .tex, or .parquet (which needs pyarrow).")] = None,
    take_in: Annotated[Path | None, typer.Option(
        help="First copy the runs of another store into this one.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the runs in a store: without --study those of its one study, or the list of its studies."""
    with _errors(as_json):
        from adaptmg import _checks as checks
        from adaptmg.cli import runs
        from adaptmg.cli.output import lines, printed, rows

        if status is not None:
            checks.choice("--status", status, ("done", "failed"))
        conditions = [runs.parsed(text) for text in where or []]
        if to is not None:
            runs.ending(to)
        if take_in is None:
            found = runs.opened(store)
        else:
            from adaptmg.study.store import Store

            runs.opened(take_in)  # no store is made for one that does not exist
            found = Store(store)
            _say(f"{found.take_in(take_in)} runs taken in from {take_in}", err=True)
        names = found.studies()
        if study is None and len(names) != 1 and not (to or conditions or status):
            table = {name: [row[k] for row in found.summaries()]
                     for k, name in enumerate(("study", "done", "failed", "seconds", "last"))}
            _say(lines(rows(table)) if as_json else printed(table, ["study"], units={"seconds": "s"}))
            return
        name = runs.chosen(store, names, study)
        table, total = runs.selected(found, name, status=status, where=conditions, details=details,
                                     limit=None if as_json or to is not None else limit)
        if to is not None:
            runs.write(table, to, runs.units(found, name, table))
            _say(f"wrote {to}", err=True)
        if as_json:
            _say(lines(rows(table)))
        elif to is None:
            rest = total - limit
            counted = "1 run" if total == 1 else f"{total} runs"
            note = f"... {rest} more: --limit, or --to FILE.csv for all" if rest > 0 else counted
            first = found.runs(name, limit=1)
            _say(printed(runs.short(table), list(first[0].parameters) if first else [],
                         units=runs.units(found, name, table), note=note))


@app.command(epilog="Example: adaptmg report results/friction.sqlite --result cycles --to friction.html")
def report(
    store: StoreOption,
    study: StudyOption = None,
    result: Annotated[list[str] | None, typer.Option(
        show_default="the first two that vary", help="Column to draw; may be given several times.")] = None,
    to: Annotated[Path | None, typer.Option(
        show_default="next to the store, named as the study", help="The HTML file to write.")] = None,
) -> None:
    """Write a page that opens offline: how many runs there are, pictures of results, all runs, those that failed."""
    with _errors():
        from adaptmg import _checks as checks
        from adaptmg.cli import runs
        from adaptmg.export import study_report

        found = runs.opened(store)
        name = runs.chosen(store, found.studies(), study)
        records = found.runs(name)
        table, _ = runs.selected(found, name)
        table.attrs["study"] = name
        parameters = {key for record in records for key in record.parameters}
        if to is None and Path(name).name != name:
            raise ValueError(f"--to must be given, as the name of the study cannot be that of a file: {name!r}")
        page = store.with_name(f"{name}.html") if to is None else checks.file_path("--to", to)
        csv = page.with_suffix(".csv")
        if csv == page:
            raise ValueError(f"--to must be an HTML file, got {checks.shown(str(to))}: its table goes into a .csv "
                             "next to it")
        written = study_report(table, page, parameters=[key for key in table if key in parameters], results=result,
                               csv=csv.name, units=runs.units(found, name, table),
                               summary=runs.same_in_all(records, table), made=runs.made(records))
        runs.write(table, csv)
        _say(f"wrote {written} and {csv}", err=True)
