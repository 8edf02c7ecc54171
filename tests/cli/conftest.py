"""The command line, run in this process."""

from collections.abc import Callable

import pytest
from matplotlib.figure import Figure

from adaptmg.cli import main

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(capsys, monkeypatch, tmp_path) -> Command:
    """Run ``adaptmg`` in a folder of its own: exit code, standard output, standard error."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    savefig = Figure.savefig
    monkeypatch.setattr(
        Figure,
        "savefig",
        lambda self, file, **options: savefig(self, file, **options | {"dpi": 30}),
    )

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main(arguments)
        out, err = capsys.readouterr()
        return end.value.code or 0, out, err

    return run
