"""The commands and their options. What is heavy is imported inside them, so that ``--help`` is instant."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from adaptmg import __version__
from adaptmg.cli.choices import (
    CorrectionName,
    EngineName,
    IndicatorName,
    LawName,
    LinearName,
    Shape,
    SolverName,
    TransferName,
)
from adaptmg.runtime.text import printable

__all__ = ["app", "main"]

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
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the benchmark cases, or say what one is: arguments with units and defaults, boundaries, loads."""
    with _told(as_json):
        from adaptmg.cases import CASES

        if case is not None:
            from adaptmg.cli.described import guide

            _say(json.dumps(guide.case_facts(case), indent=2) if as_json else guide.about_case(case))
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
    case: Annotated[str, typer.Argument(help="Name of a case, see 'adaptmg cases'.")],
    divisions: Annotated[str | None, typer.Option(
        show_default="4,8,16,32; 3D: 2,4,8", help="Uniform nested grids: cells a side, coarse to fine.")] = None,
    sizes: Annotated[str | None, typer.Option(
        help="Independent graded meshes instead: element sizes in m, coarse to fine.")] = None,
    contact_ratio: Annotated[float | None, typer.Option(
        show_default="1", help="With --sizes: size away from contact over size at contact.")] = None,
    transfer: Annotated[TransferName | None, typer.Option(
        show_default="interpolation", help="With --sizes: transfer between the grids.")] = None,
    law: Annotated[LawName | None, typer.Option(show_default="that of the case", help="Contact law.")] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of Coulomb friction.")] = None,
    limit: Annotated[float | None, typer.Option(help="Tresca limit, Pa.")] = None,
    own: Annotated[list[str] | None, typer.Option(
        "--set", metavar="NAME=VALUE", help="Argument of the case, see 'adaptmg cases NAME'; several times.")] = None,
    solver: Annotated[SolverName, typer.Option(help="Method.")] = SolverName.FULL,
    correction: Annotated[CorrectionName | None, typer.Option(
        show_default="truncated, or monotone with --cycle, --pre, --post, --omega",
        help="Multigrid: correction.")] = None,
    cycle: Annotated[Shape | None, typer.Option(show_default="V", help="Multigrid: shape of the cycle.")] = None,
    pre: Annotated[int | None, typer.Option(show_default="2", help="Multigrid: sweeps before the correction.")] = None,
    post: Annotated[int | None, typer.Option(show_default="0", help="Multigrid: sweeps after the correction.")] = None,
    omega: Annotated[float | None, typer.Option(show_default="1", help="Relaxation of the sweeps.")] = None,
    linear: Annotated[LinearName | None, typer.Option(show_default="direct", help="Active set: linear solver.")] = None,
    rtol: Annotated[float | None, typer.Option(
        show_default="that of the method", help="Tolerance: estimated relative error in the energy norm.")] = None,
    most: Annotated[int | None, typer.Option(
        "--max-cycles", show_default="that of the method", help="Cycles, sweeps or Newton steps at most.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the result (.npz), pictures and a .vtu file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Solve a case and say how it went.

    Exit code 1 if the tolerance was not reached, 2 for bad input, 130 for Ctrl-C.
    """
    with _told(as_json):
        from adaptmg.cli import work
        from adaptmg.cli.methods import method_of
        from adaptmg.cli.progress import watched

        folder = None if out is None else work.out_folder(out)
        problem = work.problem_of(case, law, friction, limit, own or ())
        method = method_of(solver, correction=correction, cycle=cycle, pre=pre, post=post, omega=omega, linear=linear,
                           rtol=rtol, most=most)
        with watched(method.rtol) as callback:
            grids = work.hierarchy_of(problem, divisions, sizes, contact_ratio, transfer)
            result = work.solved(grids, method, callback)
        files = [] if folder is None else work.write(folder, problem, grids, result)
        if as_json:
            _say(json.dumps(work.summary(result, files), indent=2, allow_nan=False))
        else:
            _say("\n".join([repr(grids), "", repr(result), *(f"wrote {file}" for file in files)]))
    if not result.status.ok:
        _say(f"adaptmg: not converged ({result.status.name}): {result.status.value}", err=True)
        raise typer.Exit(1)


@app.command(epilog="Example: adaptmg adapt upset_block --max-nodes 20000 --engine bisect --out results/upset")
def adapt(
    case: Annotated[str, typer.Argument(help="Name of a case, see 'adaptmg cases'.")],
    start: Annotated[float | None, typer.Option(
        show_default="an eighth of a body", help="Element size of the first mesh, m.")] = None,
    tolerance: Annotated[float | None, typer.Option(
        help="Stop when the estimate is so small, relative to the energy norm of the displacement.")] = None,
    max_nodes: Annotated[int | None, typer.Option(
        show_default="20000 if no limit is given", help="Nodes at most.")] = None,
    max_seconds: Annotated[float | None, typer.Option(help="Begin no step after so many seconds.")] = None,
    engine: Annotated[EngineName, typer.Option(
        help="Meshes made anew by sizes, or marked elements bisected.")] = EngineName.REMESH,
    indicator: Annotated[IndicatorName, typer.Option(help="What estimates the error.")] = IndicatorName.RESIDUAL,
    theta: Annotated[float, typer.Option(help="Share of the estimate whose elements are marked (bisect).")] = 0.5,
    law: Annotated[LawName | None, typer.Option(show_default="that of the case", help="Contact law.")] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of Coulomb friction.")] = None,
    limit: Annotated[float | None, typer.Option(help="Tresca limit, Pa.")] = None,
    own: Annotated[list[str] | None, typer.Option(
        "--set", metavar="NAME=VALUE", help="Argument of the case, see 'adaptmg cases NAME'; several times.")] = None,
    out: Annotated[Path | None, typer.Option(
        help="Directory for the last result (.npz), pictures and a .vtu file.")] = None,
    store: Annotated[Path | None, typer.Option(
        help="Directory where every step is kept; a loop that was broken off goes on there.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Solve a case on meshes that follow the error, until a limit is reached: a line a step.

    Exit code 1 if a mesh could not be solved to its tolerance, 2 for bad input, 130 for Ctrl-C: with --store the same
    command goes on.
    """
    with _told(as_json, "" if store is None else "what is done is stored, the same command goes on"):
        from adaptmg.cli import adaptive, work
        from adaptmg.cli.progress import watched_loop

        folder = None if out is None else work.out_folder(out)
        problem = work.problem_of(case, law, friction, limit, own or ())
        told: list[str] = []
        with watched_loop() as progress:
            # lines would run into the bar: they wait until it has gone
            say = told.append if as_json or progress is not None else _say
            steps = adaptive.stepped(problem, start, indicator, engine, theta,
                                     adaptive.limits(tolerance, max_nodes, max_seconds), store, progress, say)
        files = [] if folder is None else adaptive.write(folder, problem, steps)
        if as_json:
            _say(json.dumps(adaptive.summary(steps, files), indent=2, allow_nan=False))
        else:
            last = steps[-1]
            _say("\n".join([*told, last.outcome, "", repr(last.result), *(f"wrote {file}" for file in files)]))


@contextmanager
def _told(as_json: bool = False, go_on: str = "") -> Iterator[None]:
    """Bad input and files that cannot be written become a line on standard error and exit code 2; Ctrl-C is 130.

    Parameters
    ----------
    as_json : bool
        Print {"error": TEXT} too, as whoever reads JSON wants some.
    go_on : str
        What to say of an interrupt.
    """
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            yield
    except BrokenPipeError:
        raise  # who read the output has gone: typer ends quietly
    except KeyboardInterrupt:
        _fail(f"interrupted{': ' * bool(go_on)}{go_on}", as_json)
        raise typer.Exit(130) from None
    except (ValueError, TypeError, OSError, MemoryError, ArithmeticError, RuntimeError) as error:
        # by its name: solvers may not be loaded
        missed = "NotConverged" in {kind.__name__ for kind in type(error).__mro__}
        _fail(f"{'not converged: ' * missed}{' '.join(_words(error).split())}", as_json)
        raise typer.Exit(1 if missed else 2) from None


def _warn(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any) -> None:
    """A warning as a line; where in Python it arose is of no use here."""
    _say(f"adaptmg: warning: {' '.join(str(message).split())}", err=True)


def _fail(text: str, as_json: bool) -> None:
    if as_json:
        _say(json.dumps({"error": text}))
    _say(f"adaptmg: {text}", err=True)


def _words(error: Exception) -> str:
    """What an exception says, without numbers of the operating system."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.strerror}: {error.filename!r}"
    if isinstance(error, MemoryError):
        return f"not enough memory: take fewer or larger elements ({error})"
    plain = isinstance(error, ValueError | TypeError | OSError) or hasattr(error, "result")
    return str(error) if plain else f"{type(error).__name__}: {error}"


def _say(text: str, err: bool = False) -> None:
    """Print a text whatever is in it and whatever the terminal can show; characters it cannot become codes."""
    stream = sys.stderr if err else sys.stdout
    code = getattr(stream, "encoding", None) or "utf-8"
    typer.echo(printable(text).encode(code, "backslashreplace").decode(code), err=err)
