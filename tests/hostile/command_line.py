"""Bad input of ``adaptmg solve``: one line on standard error that names the option, and exit code 2."""

import contextlib
import io
import os
from collections.abc import Callable
from pathlib import Path
from unittest import mock

from hostile_table import Hostile

from adaptmg.cli import build, main


def command(*arguments: str, code: int = 2) -> None:
    """Run the command here, check how it ends and what it prints; raise what it says."""
    out, err = io.StringIO(), io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), contextlib.suppress(SystemExit):
        try:
            main(arguments)
        except SystemExit as end:
            assert end.code == code, end.code
            raise
    err.seek(0)
    text = err.read()
    lines = [line for line in text.splitlines() if line.startswith("adaptmg: ")]
    assert not out.getvalue() and "Traceback" not in text and len(lines) == 1, (out.getvalue(), text)
    raise ValueError(lines[-1])


def during(error: BaseException, code: int = 2) -> Callable[[], None]:
    """The command where solving fails with ``error``."""
    def run() -> None:
        def failing(*arguments: object) -> None:
            raise error

        with mock.patch.object(build, "solved", failing):
            command("solve", "greco_bar", "--divisions", "2,4", code=code)

    return run


_SOLVE = {
    "divisions": ("0", "4,99999999999999999999999", "4,x", "", "\udcff", "9" * 5000),
    "sizes": ("1e-9", "nan", "x"), "friction": ("nan",), "rtol": ("0",), "max-cycles": ("0",), "omega": ("2",),
}


def _options():
    for option, values in _SOLVE.items():
        for value in values:
            given = f"--{option}={value}"
            yield Hostile(ascii(given)[:40], lambda g=given: command("solve", "greco_bar", g),
                          "cycles" if option == "max-cycles" else option.rstrip("s"), ValueError)
    yield Hostile("fine to coarse", lambda: command("solve", "greco_bar", "--divisions=8,4"), "coarse to fine",
                  ValueError)
    for option, value in {"friction": "much", "law": "hooke", "pre": "1.5", "nothing": "1"}.items():
        yield Hostile(f"--{option} {value}", lambda o=option, v=value: command("solve", "greco_bar", f"--{o}", v),
                      option, ValueError)
    for option, value in {"max-nodes": "0", "start": "-1", "theta": "2", "tolerance": "nan"}.items():
        yield Hostile(f"adapt --{option}", lambda o=option, v=value: command("adapt", "upset_block", f"--{o}={v}"),
                      option.replace("-", "_"), ValueError)
    for label, case in {"unknown": "greco_bax", "surrogate": "\udcff", "control": "a\x1b[31m"}.items():
        says = "did you mean 'greco_bar'" if label == "unknown" else "there is no case"
        yield Hostile(f"case {label}", lambda c=case: command("solve", c), says, ValueError)
    both = {"sizes and divisions": ("--sizes=1e-2", "--divisions=4", "--divisions"),
            "ratio alone": ("--contact-ratio=2", "--divisions=4", "--contact-ratio"),
            "ratio below one": ("--contact-ratio=0.5", "--sizes=1e-2", "ratio"),
            "ratio huge": ("--contact-ratio=1e300", "--sizes=1e-2", "take larger sizes"),
            "useless option": ("--solver=active-set", "--omega=1", "--omega"),
            "law without friction": ("--law=coulomb", "--divisions=2", "--friction"),
            "two laws": ("--friction=1", "--limit=1", "belongs to --law tresca"),
            "transfer of uniform grids": ("--transfer=l2", "--divisions=2", "--transfer has no meaning for uniform"),
            "cycle of one grid": ("--solver=single-grid", "--cycle=W", "--shape has no meaning"),
            **{f"--set {text}": (f"--set={text}", "--divisions=2", says) for text, says in {
                "yong=1": "did you mean 'young'", "young": "NAME=VALUE", "young=": "NAME=VALUE", "young=-1": "> 0",
                "young=steel": "young must be a number"}.items()}}
    for name, (first, second, says) in both.items():
        yield Hostile(name, lambda a=first, b=second: command("solve", "greco_bar", a, b), says, ValueError)


def _outputs():
    def solve(out: str, make: Callable[[], object] = lambda: None) -> None:
        make()
        command("solve", "greco_bar", "--divisions=2,4", f"--out={out}")

    yield Hostile("--out a device", lambda: solve("/dev/null"), "--out", ValueError)
    yield Hostile("--out below a device", lambda: solve("/dev/null/x"), "--out", ValueError)
    yield Hostile("--out a file", lambda: solve("there", lambda: Path("there").write_text("")), "there", ValueError,
                  writes=True)
    yield Hostile("--out with a folder in the way", lambda: solve(
        "there", lambda: Path("there/result.npz").mkdir(parents=True)), "result.npz", ValueError, writes=True)
    yield Hostile("--out nobody's home", lambda: solve("~nobody-here/x"), "--out", ValueError)
    yield Hostile("--out with a long name", lambda: solve("n" * 300), "n" * 300, ValueError)
    yield Hostile("--out a dangling link in the way", lambda: solve("there", lambda: os.symlink("there", "there")),
                  "there", ValueError, writes=True)


def _failures():
    """What may go wrong inside."""
    for name, error, says in (
            ("no memory", MemoryError("Unable to allocate 7 TiB"), "not enough memory"),
            ("surrogates in an error", ValueError("the name '\udcff\x00' of \xb5"), "\\udcff\\x00"),
            ("lines in an error", ValueError("one\ntwo\r\nthree"), "one two three"),
            ("a library's error", RuntimeError("Mesh Loading Error"), "Mesh Loading")):
        yield Hostile(name, during(error), says, ValueError)
    yield Hostile("Ctrl-C", during(KeyboardInterrupt(), 130), "interrupted", ValueError)


INPUTS = (*_options(), *_outputs(), *_failures())
