"""The command line, run in this process."""

from collections.abc import Callable, Iterator

import matplotlib
import pytest

from adaptmg.cli import main

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(capsys, monkeypatch, tmp_path) -> Iterator[Command]:
    """Run ``adaptmg`` in a folder of its own: exit code, standard output, standard error."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main(arguments)
        out, err = capsys.readouterr()
        return end.value.code or 0, out, err

    with matplotlib.rc_context({"savefig.dpi": 30}):
        yield run
