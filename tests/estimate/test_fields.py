"""What estimates are made of: neighbours as the sorted table has them, stresses as the measures have them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made import square
from simplex_meshes import random_box
from uncompiled import uncompile

import adaptmg as am
from adaptmg.discrete.stress import StressData
from adaptmg.estimate import stress_fields as module
from adaptmg.estimate.stress_fields import element_stress, neighbours
from adaptmg.mesh.arrays import element_facets, facet_keys, facet_table

MATERIALS = {2: (am.PlaneStrain, am.PlaneStress, am.Axisymmetric), 3: (am.Solid,)}


@pytest.fixture(params=[False, True], ids=["compiled", "plain"])
def jit(request, monkeypatch):
    if request.param:
        uncompile(monkeypatch, module)
    return request.param


@pytest.mark.parametrize("dim", [2, 3])
def test_neighbours_are_those_of_the_sorted_table(dim, jit):
    mesh = random_box(12 if jit else 40, dim, 5)
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


@pytest.mark.parametrize(("dim", "kind"), [(dim, kind) for dim, kinds in MATERIALS.items() for kind in kinds])
def test_stresses_are_those_of_the_result(dim, kind, jit):
    mesh = random_box(10, dim, 2)
    mesh = dataclasses.replace(mesh, bodies=("a", "b"), element_body=np.arange(len(mesh.elements)) % 2)
    materials = {"a": kind(young=2e11, poisson=0.3), "b": kind(young=7e10, poisson=0.1)}
    strain = am.InitialStrain("b", (1e-4, -2e-4, 3e-4))
    data = StressData.of(mesh, materials, [strain])
    u = 1e-3 * np.random.default_rng(0).standard_normal(mesh.points.shape)
    wanted, found = data.tensors(mesh, u), element_stress(mesh, u, data)
    i, j = ([0, 1, 0], [0, 1, 1]) if dim == 2 else ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])
    values = found.values.copy()
    if kind is am.Axisymmetric:
        middle = np.full((1, 3), 1 / 3)
        values[:, :2] += data.lame[mesh.element_body][:, None] * found.hoop(mesh.elements, middle)
    np.testing.assert_allclose(values, wanted[:, i, j], rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
    # tractions: the tensor times the normal
    normals = np.random.default_rng(1).standard_normal((len(mesh.elements), dim))
    if kind is not am.Axisymmetric:
        facets = element_facets(mesh.elements)[:, 0]
        got = found.tractions(np.arange(len(mesh.elements)), normals, facets, np.full((1, dim), 1 / dim))[:, 0]
        np.testing.assert_allclose(got, np.einsum("eij,ej->ei", wanted[:, :dim, :dim], normals), rtol=1e-9,
                                   atol=1e-12 * np.abs(wanted).max())
