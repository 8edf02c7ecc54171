"""Bad input of ``adaptmg solve``: one line on standard error that names the option, and exit code
2."""

import contextlib
import io
from collections.abc import Callable
from unittest import mock

from hostile_table import Hostile

from adaptmg.cli import build, main


def command(*arguments: str, code: int = 2) -> None:
    """Run the command here, check how it ends and what it prints; raise what it says."""
    out, err = io.StringIO(), io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        contextlib.suppress(SystemExit),
    ):
        try:
            main(arguments)
        except SystemExit as end:
            assert end.code == code, end.code
            raise
    err.seek(0)
    text = err.read()
    lines = [line for line in text.splitlines() if line.startswith("adaptmg: ")]
    assert not out.getvalue() and "Traceback" not in text and len(lines) == 1, (
        out.getvalue(),
        text,
    )
    raise ValueError(lines[-1])


def during(error: BaseException, code: int = 2) -> Callable[[], None]:
    """The command where solving fails with ``error``."""

    def run() -> None:
        def failing(*arguments: object) -> None:
            raise error

        with mock.patch.object(build, "solved", failing):
            command("solve", "greco_bar", "--divisions", "2,4", code=code)

    return run


#: what the line says, and the arguments after "adaptmg solve greco_bar"
_SOLVE = {
    "division": (
        "--divisions=0",
        "--divisions=4,99999999999999999999999",
        "--divisions=4,x",
        "--divisions=",
        "--divisions=\udcff",
        f"--divisions={'9' * 5000}",
    ),
    "size": ("--sizes=1e-9", "--sizes=nan"),
    "coarse to fine": ("--divisions=8,4",),
    "cycles": ("--max-cycles=0",),
    "friction": ("--friction=nan", "--friction much"),
    "law": ("--law hooke",),
    "pre": ("--pre 1.5",),
    "nothing": ("--nothing 1",),
    "--divisions": ("--sizes=1e-2 --divisions=4",),
    "--contact-ratio": ("--contact-ratio=2 --divisions=4",),
    "ratio": ("--contact-ratio=0.5 --sizes=1e-2",),
    "take larger sizes": ("--contact-ratio=1e300 --sizes=1e-2",),
    "--omega": ("--solver=active-set --omega=1",),
    "--friction": ("--law=coulomb --divisions=2",),
    "belongs to --law tresca": ("--friction=1 --limit=1",),
    "--transfer has no meaning for uniform": ("--transfer=l2 --divisions=2",),
    "--shape has no meaning": ("--solver=single-grid --cycle=W",),
    "NAME=VALUE": ("--set=young",),
    "did you mean 'young'": ("--set=yong=1",),
    "> 0": ("--set=young=-1",),
    "must be a number": ("--set=young=steel",),
    "--out": ("--divisions=2,4 --out=/dev/null/x", "--divisions=2,4 --out=~nobody-here/x"),
}
_ADAPT = {
    "max_nodes": "--max-nodes=0",
    "start": "--start=-1",
    "theta": "--theta=2",
    "tolerance": "--tolerance=nan",
}
_CASES = {"did you mean 'greco_bar'": "greco_bax", "name must be printable": "a\x1b[31m"}


def _options():
    for says, lines in _SOLVE.items():
        for line in lines:
            yield Hostile(
                ascii(line)[:60],
                lambda g=line: command("solve", "greco_bar", *g.split(" ")),
                says,
                ValueError,
            )
    for says, option in _ADAPT.items():
        yield Hostile(option, lambda o=option: command("adapt", "upset_block", o), says, ValueError)
    for says, case in _CASES.items():
        yield Hostile(f"case {case!a}", lambda c=case: command("solve", c), says, ValueError)


def _failures():
    """What may go wrong inside."""
    for name, error, says in (
        ("no memory", MemoryError("Unable to allocate 7 TiB"), "not enough memory"),
        ("surrogates in an error", ValueError("the name '\udcff\x00' of \xb5"), "\\udcff\\x00"),
        ("lines in an error", ValueError("one\ntwo\r\nthree"), "one two three"),
        ("a library's error", RuntimeError("Mesh Loading Error"), "Mesh Loading"),
    ):
        yield Hostile(name, during(error), says, ValueError)
    yield Hostile("Ctrl-C", during(KeyboardInterrupt(), 130), "interrupted", ValueError)


INPUTS = (*_options(), *_failures())
