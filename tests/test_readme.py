"""The examples of the README run as they stand, and its commands are the ones that work."""

import re
from pathlib import Path

import pytest

import adaptmg as am

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 6
    strut, loop = blocks.pop(3), blocks.pop(2)
    for block in blocks[:3]:
        exec(compile(block, "README.md", "exec"), names)
        assert names["result"].status is am.Status.CONVERGED and names["result"].residual < 1e-7
    assert names["steps"].complete
    exec(compile(loop, "README.md", "exec"), names)
    assert names["step"].outcome.startswith("max_nodes") and names["step"].nodes > 10_000
    with pytest.warns(RuntimeWarning, match="may not be unique"):
        exec(compile(strut, "README.md", "exec"), names)
    found = [set(names[name].contact.state.tolist()) - {am.OPEN} for name in ("open_", "slips", "sticks")]
    assert found == [set(), {am.SLIP}, {am.STICK}]
    exec(compile(blocks[3], "README.md", "exec"), names)
    table = names["study"].table()
    assert len(table) == 8 and (table["status"] == "done").all() and (table["outcome"] == "CONVERGED").all()
    written = {"contact.png", "run.npz", "bodies.png", "history.png", "adaptation.png", "results"}
    assert written <= {path.name for path in tmp_path.iterdir()}


def test_commands_and_files_exist():
    for command in ("pip install -e \".[dev]\" && .venv/bin/python studies/reproduce.py", "&& .venv/bin/pytest"):
        assert command in README
    for path in re.findall(r"\]\((data/[^)]*)\)", README) + re.findall(r"`(studies/\w+\.py)`", README):
        assert (ROOT / path).exists(), path
