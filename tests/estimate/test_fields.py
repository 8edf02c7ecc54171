"""Neighbours as the sorted table has them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made import square
from simplex_meshes import random_box
from uncompiled import uncompile

from adaptmg.estimate import stress_fields as module
from adaptmg.estimate.stress_fields import neighbours
from adaptmg.mesh.arrays import element_facets, facet_keys, facet_table


@pytest.mark.parametrize("plain", [False, True], ids=["compiled", "plain"])
@pytest.mark.parametrize("dim", [2, 3])
def test_neighbours_are_those_of_the_sorted_table(dim, plain, monkeypatch):
    if plain:
        uncompile(monkeypatch, module)
    mesh = random_box(12 if plain else 40, dim, 5)
    found, table = neighbours(mesh), facet_table(mesh.elements, mesh.n_nodes)
    row = table.find(facet_keys(element_facets(mesh.elements).reshape(-1, dim), mesh.n_nodes)).reshape(-1, dim + 1)
    own = np.arange(len(mesh.elements))[:, None]
    np.testing.assert_array_equal(found.across, np.where(table.first[row] == own, table.second[row], table.first[row]))
    assert (found.across < 0).sum() == len(mesh.facets)
    opposite = element_facets(mesh.elements)[found.owner, found.corner]
    np.testing.assert_array_equal(np.sort(opposite, axis=1), np.sort(mesh.facets, axis=1))
    assert (found.across[found.owner, found.corner] < 0).all()


def test_a_facet_of_no_element_is_refused():
    mesh = square(2)
    wrong = dataclasses.replace(mesh, facets=np.vstack([mesh.facets[:-1], [[0, 8]]]))
    with pytest.raises(ValueError, match=r"boundary facet 7 of nodes \[0, 8\] belongs to no element"):
        neighbours(wrong)
