"""Ways in which what a run computes can change, and ways in which its text can that change nothing.

Each is a script with a function ``run``, before and after, loaded again; ``code_changes.txt`` is the
table. '=== KIND: NAME' begins a change, '### FILE' a file next to script.py, '<<a|>b>>' is a before
the change and b after it. KIND: seen (rows become stale), refused (with a way out), unseen (as the
documentation says), same."""

import importlib
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from adaptmg.solver.fingerprint import fingerprint

TABLE = [
    re.match(r"(\w+): (.*?)\n(.*)", block, re.DOTALL).groups()
    for block in Path(__file__)
    .with_name("code_changes.txt")
    .read_text(encoding="utf-8")
    .split("=== ")[1:]
]
BOTH = re.compile(r"<<(.*?)\|>(.*?)>>", re.DOTALL)


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Write the files of a script and load it, without any of a script before."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)  # and taken out in the end
    before, path, turn = set(sys.modules), list(sys.path), iter(range(10))

    def forget():
        for name in set(sys.modules) - before:
            module = sys.modules[name]
            if (
                str(tmp_path)
                in f"{getattr(module, '__file__', '')} {getattr(module, '__path__', '')}"
            ):
                del sys.modules[name]

    def loaded(text: str) -> Any:
        forget()
        folder = tmp_path / f"{next(turn)}"
        for part in f"script.py\n{text}".split("### "):
            name, _, body = part.partition("\n")
            file = folder / name.strip()
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(body, encoding="utf-8")
        sys.path[:] = [str(folder), *path]
        importlib.invalidate_caches()
        monkeypatch.chdir(folder)
        return importlib.import_module("script")

    yield loaded
    forget()


def known(script: Any) -> str:
    """The fingerprint, or why there is none; it does not depend on what a run has loaded or
    called."""
    try:
        code = fingerprint(script.run).code
    except TypeError as error:
        return f"refused: {error}"
    return code


def value(script: Any) -> str:
    try:
        return repr(script.run(3))
    except ValueError as error:
        return repr(error)


@pytest.mark.parametrize(
    ("kind", "text"), [pytest.param(kind, text, id=name) for kind, name, text in TABLE]
)
def test_a_change_is_seen_where_it_changes_what_a_run_gives(load, kind, text):
    found = []
    for side in (r"\1", r"\2"):
        script = load(BOTH.sub(side, text))
        found.append((known(script), value(script)))
    (code, result), (code_after, result_after) = found
    assert (result == result_after) == (kind == "same")
    if kind == "refused":
        assert code.startswith("refused: ") and re.search(r"depends=\{'\w+': \.\.\.\}", code), code
    else:
        assert not code.startswith("refused") and (code != code_after) == (kind == "seen")
    again = load(BOTH.sub(r"\1", text))
    assert known(again) == code


def test_of_an_edited_module_the_code_that_runs_counts(load):
    text = "def run(n):\n    import other\n    return {'m': other.f()}\n### other.py\ndef f():\n    return 1\n"
    script = load(text)
    first, _ = known(script), value(script)
    assert known(script) == first
    file = Path(sys.modules["other"].__file__)
    file.write_text("# what it is\ndef f():\n    return 1\n", encoding="utf-8")
    assert known(script) == first
    file.write_text("def f():\n    return 2\n", encoding="utf-8")
    stale, there = known(script), value(script)
    importlib.reload(sys.modules["other"])
    fresh = known(script)
    assert there == "{'m': 1}" and value(script) == "{'m': 2}" and first == stale != fresh
    assert known(load(text.replace("return 1", "return 2"))) == fresh
