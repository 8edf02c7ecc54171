"""The documentation: every public name has a page, tutorials are short, and the first one is a notebook that runs."""

import importlib.util
from pathlib import Path

import pytest

import adaptmg as am

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted((ROOT / "studies" / "tutorials").glob("*.py"))


def test_every_public_name_is_on_one_page_of_the_reference():
    spec = importlib.util.spec_from_file_location("build_docs", ROOT / "studies" / "docs.py")
    docs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(docs)
    listed = [name for names in docs.public_names().values() for name in names]
    public = [*am._HOME] + [f"{module}.{name}" for module in am._SUBMODULES if module != "solver"
                            for name in getattr(am, module).__all__ if name not in am._HOME]
    assert sorted(listed) == sorted(public)


def test_tutorials_are_short():
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in TUTORIALS}
    assert len(lines) == 10 and max(lines.values()) <= 40, lines


@pytest.mark.slow
def test_the_first_tutorial_runs_as_a_notebook(tmp_path, monkeypatch):
    convert = pytest.importorskip("sphinx_gallery.notebook").python_to_jupyter_cli
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    monkeypatch.chdir(tmp_path)
    script = tmp_path / TUTORIALS[0].name
    script.write_text(TUTORIALS[0].read_text(encoding="utf-8"), encoding="utf-8")
    convert([str(script)])
    notebook = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    nbclient.NotebookClient(notebook, timeout=300).execute()
    shown = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert any("CONVERGED" in str(output) for output in shown)
