"""VTK files hold the result exactly; reports are one page that needs nothing else."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from made import cube, result_on, square

from adaptmg.export import Report, vtk
from adaptmg.export import report as report_module

meshio = pytest.importorskip("meshio")


@pytest.fixture(autouse=True)
def known_versions(monkeypatch):
    monkeypatch.setattr(report_module, "environment", lambda: {"python": "3.x", "adaptmg": "0.0"})


@pytest.mark.parametrize("mesh", [square(4), cube(2)], ids=["2D", "3D"])
def test_vtk_holds_the_result(tmp_path, mesh):
    result = result_on(mesh)
    path = tmp_path / "r.vtu"
    vtk(result, path)
    read = meshio.read(path)
    dim, contact = mesh.dim, result.contact
    np.testing.assert_array_equal(read.points[:, :dim], mesh.points)
    kind = "triangle" if dim == 2 else "tetra"
    np.testing.assert_array_equal(read.cells_dict[kind], mesh.elements)
    np.testing.assert_array_equal(read.point_data["displacement"][:, :dim], result.displacement)
    np.testing.assert_array_equal(read.point_data["contact_pressure"][contact.node], contact.pressure)
    np.testing.assert_array_equal(read.point_data["contact_state"][contact.node], contact.state)
    slip = read.point_data["contact_slip"][contact.node]
    np.testing.assert_allclose(slip[:, 0], contact.slip[:, 0], rtol=1e-15)
    away = np.setdiff1d(np.arange(mesh.n_nodes), contact.node)
    assert np.isnan(read.point_data["contact_gap"][away]).all()
    assert (read.point_data["contact_state"][away] == -1).all()
    assert list(tmp_path.iterdir()) == [path]


def test_vtk_refuses_what_it_cannot_write(tmp_path):
    with pytest.raises(ValueError, match="no mesh"):
        vtk(result_on(None), tmp_path / "r.vtu")
    with pytest.raises(ValueError, match=r"\.vtu"):
        vtk(result_on(square(2)), tmp_path / "r.vtk")
    with pytest.raises(TypeError, match="Result"):
        vtk("result", tmp_path / "r.vtu")
    with pytest.raises(FileNotFoundError):
        vtk(result_on(square(2)), tmp_path / "nowhere" / "r.vtu")
    assert not list(tmp_path.iterdir())


class _Tags(HTMLParser):
    """Collects start tags, and checks that they nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict]] = []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def _page(tmp_path) -> str:
    page = Report("Smoothing & <co>", "One.\n\nTwo <b>.")
    page.section("Sweeps <1>", "Text & more.")
    page.table(pd.DataFrame({"n<": [1], "t": ["<script>"]}), "Table 1 & so on", "note <i>", units={"t": "µs"})
    figure, ax = plt.subplots()
    ax.plot([0, 1])
    page.figure(figure, 'A "picture" <x>')
    assert not plt.fignum_exists(figure.number)
    page.section("Second")
    return page.write(tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_report_is_one_well_formed_page_with_everything_in_it(tmp_path):
    text = _page(tmp_path)
    tags = _Tags()
    tags.feed(text)
    assert not tags.open
    assert [tmp_path / "report.html"] == list(tmp_path.iterdir())
    (image,) = [a for t, a in tags.seen if t == "img"]
    kind, data = image["src"].split(",")
    assert kind == "data:image/png;base64" and base64.b64decode(data).startswith(b"\x89PNG")
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    targets = {a["id"] for t, a in tags.seen if "id" in a}
    links = [a["href"] for t, a in tags.seen if t == "a"]
    assert links == ["#section-1", "#section-2"] and {x[1:] for x in links} <= targets


def test_a_report_escapes_everything(tmp_path):
    text = _page(tmp_path)
    for raw in ("<script>", "<co>", "<b>", "<i>", "<x>", "Sweeps <1>", "n<<"):
        assert raw not in text
    assert "Smoothing &amp; &lt;co&gt;" in text and "A &quot;picture&quot;" in text and "adaptmg 0.0" in text


def test_a_report_checks_what_it_is_given(tmp_path):
    page = Report("x")
    with pytest.raises(TypeError, match="DataFrame"):
        page.table([[1]], "caption")
    with pytest.raises(ValueError, match="caption"):
        page.table(pd.DataFrame({"a": [1]}), "")
    with pytest.raises(TypeError, match="Figure"):
        page.figure("file.png", "caption")
    with pytest.raises(ValueError, match="title"):
        Report("")
    with pytest.raises(FileNotFoundError):
        page.write(tmp_path / "nowhere" / "x.html")
