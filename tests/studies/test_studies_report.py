"""The report of the studies: what stands on its first screen, what is said where a study has not run, its size."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from pages import Page
from study_scripts import load

common, front, reproduce = load("common"), load("front"), load("reproduce")


def section(name: str, **frames: pd.DataFrame):
    """A section of tables by name."""
    return common.Section(f"Title of {name}", "Text.", [common.Table(key, frame, key) for key, frame in frames.items()])


def grid_count():
    return section("grid_count", table1=pd.DataFrame({
        "method": list("abcd"), "grids": ["1089", "1089/289", "1089/289/81", "1089/289/81/25"],
        "paper": [1.0, 7.2, 21.7, 27.3], "monotone, complete": [1.0, 8.3, 25.7, 50.4],
        "monotone, V": [1.0, np.nan, 45.5, 86.3],
        "default": [1.0, 980.0, 720.0, 650.0], "paper's mode": [1.0, 7.2, 4.6, 29.5],
        "its true error": [6e-4, 2e-3, 7e-3, 1.7e-2]}))


def adaptive():
    """Three problems: bisected meshes are 3, 1.5 and 2 times quicker, remeshed ones never."""
    ratios = {"bar": 3.0, "punch": 1.5, "block": 2.0}
    lines = [{"problem": name, "meshes": f"residual, {engine}", "energy": error, front.OVER: ratio * over,
              "uniform": "measured"} for name, ratio in ratios.items()
             for engine, over in (("bisected", 1), ("remeshed", .1)) for error in (4.0, 2.0)]
    lines += [{"problem": name, "meshes": "uniform", "energy": 2.0, front.OVER: np.nan, "uniform": ""}
              for name in ratios]
    paying = pd.DataFrame({"problem": list(ratios), "time, bisected": list(ratios.values()), "time, remeshed": 0.05,
                           "bisected pays below": ["all (4)", "3", "2.5"], "remeshed pays below": "no"})
    return section("adaptive", adaptive_pays=paying, adaptive_meshes=pd.DataFrame(lines))


def linear():
    return section("amg", amg_glued=pd.DataFrame({
        "grid": "uniform", "nodes": [100, 100, 900, 900], "total": [1.0, 0.5, 9.0, 4.5],
        "work": [100.0, 20.0] * 2, "method": ["AMG-CG, rigid-body modes", "contact, FullMultigrid"] * 2}))


def made(sections) -> Page:
    """The page of the studies, parsed; it leaves no figure open."""
    plt.close("all")
    text = reproduce.page_of(sections, common.Context(False, Path())).page()
    assert not plt.get_fignums()
    return Page(text)


def test_where_nothing_has_run_the_first_screen_says_so():
    page = made({})
    assert len(page.all("div", "absent")) == len(front.PLACES) == 5
    for place in front.PLACES.values():
        assert place.title in page.text("h2") and f"Not in this run: python studies/reproduce.py {place.study}" \
            in page.text("p")
        assert place.study in reproduce.STUDIES


def test_the_front_is_made_of_what_sections_deliver_and_links_to_them():
    page = made({"grid_count": grid_count(), "adaptive_vs_uniform": adaptive(), "amg_comparison": linear()})
    assert len(page.all("div", "absent")) == 2 and len(page.drawings) == 2
    links = [a["href"] for a in page.all("a")]
    assert {"#grid_count", "#adaptive_vs_uniform", "#amg_comparison", "table1.csv"} <= set(links)
    assert "50.4" in page.text("td") and "With V-cycles 86 (4 grids)" in page.text("p")
    assert "takes 0.50 times the seconds of one linear solve" in page.text("p")


@pytest.mark.parametrize("broken", [
    section("x"), section("x", table1=pd.DataFrame({"grids": ["1"]})),
    section("x", adaptive_pays=adaptive().items[0].frame,
            adaptive_meshes=adaptive().items[1].frame.query("meshes == 'uniform'"))])
def test_tables_that_lack_what_is_wanted_leave_the_rest_of_the_page(broken):
    page = made({place.study: broken for place in front.PLACES.values()} | {"grid_count": broken})
    assert len(page.all("div", "absent")) == 5 and "have nothing for this place" in page.text("p")
