"""Hierarchies: constructors, the table, and what is refused."""

import pickle
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.mesh import check_mesh

COARSE = am.mesh.structured(am.cases.greco_bar().domain, 4)


@pytest.fixture(scope="module")
def problem():
    return am.cases.greco_bar()


def affine(points):
    return 1.0 + points @ np.arange(2, 2 + points.shape[1])


@pytest.mark.parametrize("make", [
    lambda p: am.Hierarchy.uniform(p, divisions=(2, 4, 8)),
    lambda p: am.Hierarchy.uniform(p, divisions=(3, 5, 8), diagonal="alternating"),
    lambda p: am.Hierarchy.graded(p, sizes=(20e-3, 10e-3), contact_ratio=3),
    lambda p: am.Hierarchy.bisected(p, am.mesh.structured(p.domain, 4), levels=2),
    lambda p: am.Hierarchy.from_meshes(p, [am.mesh.graded(p.domain, s, "bottom").source for s in (20e-3, 9e-3)])])
def test_prolongations_reproduce_affine_fields(problem, make):
    grids = make(problem)
    for coarse, fine in zip(grids.levels[:-1], grids.levels[1:], strict=True):
        assert fine.prolongation @ affine(coarse.mesh.points) == pytest.approx(affine(fine.mesh.points), rel=1e-10)
        assert fine.mesh_ratio >= 1


def test_paper_grids(problem):
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8, 16, 32))
    assert [row["nodes"] for row in grids.table()] == [25, 81, 289, 1089]
    text = repr(grids)
    assert "1089" in text
    assert "GRECO" in text
    assert f"{grids.operator_complexity:.3f}" in text
    assert grids.grid_complexity == pytest.approx((25 + 81 + 289 + 1089) / 1089)


def test_bisected_levels_are_nested(problem):
    grids = am.Hierarchy.bisected(problem, am.mesh.structured(problem.domain, 4), levels=2)
    assert len(grids) == 3
    for coarse, fine in zip(grids.levels[:-1], grids.levels[1:], strict=True):
        n = coarse.mesh.n_nodes
        assert np.array_equal(fine.mesh.points[:n], coarse.mesh.points)
        assert abs(fine.prolongation[:n] - sparse.eye_array(n)).max() < 1e-12
    assert len(grids.finest.discrete.contact) > 2 * len(grids[0].discrete.contact)


def test_contact_rows_stay_on_the_contact_boundary(problem):
    class Nearest:
        """Takes the nearest coarse node."""

        def build(self, coarse, fine):
            node = np.argmin(np.linalg.norm(fine.points[:, None] - coarse.points, axis=2), axis=1)
            return sparse.csr_array((np.ones(len(node)), (np.arange(len(node)), node)),
                                    shape=(fine.n_nodes, coarse.n_nodes))

    sizes = (20e-3, 8e-3)
    grids = am.Hierarchy.graded(problem, sizes=sizes, transfer=Nearest())
    contact = grids[1].discrete.contact.nodes
    x = affine(grids[1].mesh.points)
    found = grids[1].prolongation @ affine(grids[0].mesh.points)
    assert found[contact] == pytest.approx(x[contact], rel=1e-12)
    assert np.abs(found - x).max() > 1e-3
    untouched = am.Hierarchy.graded(problem, sizes=sizes, transfer=Nearest(), contact_rows=False)
    assert (np.diff(untouched[1].prolongation.indptr) == 1).all()


def test_truncated(problem):
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4, 8))
    part = grids.truncated(coarsest=1)
    assert [row["nodes"] for row in part.table()] == [25, 81]
    assert part[0].prolongation is None
    assert len(grids.truncated(finest=1)) == 2
    with pytest.raises(ValueError, match="coarsest and finest"):
        grids.truncated(coarsest=2, finest=1)


def test_refusals(problem):
    with pytest.raises(ValueError, match="coarse to fine"):
        am.Hierarchy.uniform(problem, divisions=(8, 4))
    with pytest.raises(ValueError, match="no meshes"):
        am.Hierarchy.uniform(problem, divisions=())
    with pytest.raises(ValueError, match="domain is None"):
        am.Hierarchy.uniform(am.ContactProblem(material=problem.material, contact=problem.contact, law=problem.law),
                             divisions=(2, 4))
    with pytest.raises(ValueError, match=r"contact_ratio"):
        am.Hierarchy.graded(problem, sizes=(20e-3, 10e-3), contact_ratio=np.nan)
    with pytest.raises(TypeError, match="transfer must be a transfer, which offers build"):
        am.Hierarchy.graded(problem, sizes=(20e-3, 10e-3), transfer="interpolation")
    with pytest.raises(ValueError, match="levels is empty"):
        am.Hierarchy(())

    class Wrong:
        def __init__(self, matrix):
            self.matrix = matrix

        def build(self, coarse, fine):
            return self.matrix

    with pytest.raises(ValueError, match="must return a matrix of shape"):
        am.Hierarchy.graded(problem, sizes=(20e-3, 10e-3), transfer=Wrong(sparse.eye_array(3)))
    with pytest.raises(ValueError, match="prolongation must have shape"):
        levels = am.Hierarchy.uniform(problem, divisions=(2, 4)).levels
        am.Hierarchy((levels[0], am.Level(levels[1].discrete, levels[1].mesh, sparse.eye_array(3, format="csr"))))


def test_wrong_names_and_dimensions_are_refused(problem):
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
    renamed = am.MeshArrays(points=mesh.points, elements=mesh.elements, facets=mesh.facets,
                            facet_labels=mesh.facet_labels, boundaries=("south", "east", "north", "west"))
    with pytest.raises(ValueError, match=r"'bottom', used for contact, does not exist"):
        am.Hierarchy.from_meshes(problem, [renamed, am.mesh.structured(am.Rectangle(width=1, height=1), 8)])
    block = am.mesh.structured(am.Box(width=1, depth=1, height=1), 2)
    with pytest.raises(ValueError, match="3D"):
        am.Hierarchy.from_meshes(problem, [block, am.mesh.structured(am.Box(width=1, depth=1, height=1), 4)])


class Nearest:
    """Values of the nearest coarse node, of whatever body."""

    def build(self, coarse, fine):
        near = np.argmin(np.linalg.norm(fine.points[:, None] - coarse.points, axis=2), axis=1)
        return sparse.csr_array((np.ones(fine.n_nodes), (np.arange(fine.n_nodes), near)),
                                shape=(fine.n_nodes, coarse.n_nodes))


def test_a_transfer_that_mixes_bodies_is_refused():
    # bodies that touch have nodes at the same places
    with pytest.raises(ValueError, match=r"lets node \d+ of body '\w+' follow body '\w+': build the rows of each body"):
        am.Hierarchy.graded(am.cases.dovetail(), sizes=(10e-3, 6e-3), contact_ratio=2, transfer=Nearest())


@pytest.mark.parametrize("make", [
    lambda p: am.Hierarchy.uniform(p, divisions=(2, 4, 8, 16, 32, 64, 128)),
    lambda p: am.Hierarchy.graded(p, sizes=(20e-3, 10e-3, 5e-3)),
    lambda p: am.Hierarchy.bisected(p, COARSE, levels=2)])
def test_timings_add_up_to_the_whole_time(problem, make, monkeypatch):
    # of this process: another one may take the time between the clocks
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    shares = []
    for _ in range(3):
        begin = time.perf_counter()
        grids = make(problem)
        wall = time.perf_counter() - begin
        assert set(grids.timings) == {"mesh", "assembly", "transfer"} and min(grids.timings.values()) > 0
        shares.append(sum(grids.timings.values()) / wall)
    assert 0.97 < max(shares) <= 1


def test_nothing_is_made_that_nobody_asked_for(problem, monkeypatch):
    from importlib import import_module

    from adaptmg import transfer
    from adaptmg.mesh import ngsolve_bridge as build
    from adaptmg.mesh import soundness as check

    assembling = import_module("adaptmg.discrete.discretise")

    def refuse(*_args, **_kwargs):
        raise AssertionError("made without being asked for")

    for module, name in ((build, "to_ngsolve"), (check, "facet_table"), (transfer, "mesh_ratio"),
                         (assembling, "rigid_motions")):
        monkeypatch.setattr(module, name, refuse)
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4, 8))
    for level in grids.levels:
        with pytest.raises(AssertionError, match="without being asked"):
            level.mesh.source  # noqa: B018
        with pytest.raises(AssertionError, match="without being asked"):
            level.discrete.near_nullspace  # noqa: B018
    with pytest.raises(AssertionError, match="without being asked"):
        repr(grids)
    monkeypatch.undo()
    assert grids.finest.mesh.source is grids.finest.mesh.source and grids.finest.mesh.source.nv == 81
    assert grids.finest.discrete.near_nullspace is grids.finest.discrete.near_nullspace
    assert grids.finest.discrete.near_nullspace.shape == (162, 3) and grids[1].mesh_ratio == pytest.approx(2)


def test_levels_nobody_asked_can_be_pickled(problem):
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4))
    back = pickle.loads(pickle.dumps(grids))
    assert back[1].mesh_ratio == pytest.approx(2)
    np.testing.assert_array_equal(back[1].discrete.near_nullspace, grids[1].discrete.near_nullspace)


@pytest.mark.parametrize("make", [
    lambda: am.Hierarchy.uniform(am.cases.greco_block(), divisions=(2, 4)),
    lambda: am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 10e-3), contact_ratio=2),
    lambda: am.Hierarchy.uniform(am.cases.two_block_patch(), divisions=(4, 8))])
def test_what_the_package_assembles_passes_the_checks_of_a_strangers_problem(make):
    for level in make().levels:
        given = level.discrete
        again = replace(given)
        assert "_assembled" in vars(given) and "_assembled" not in vars(again)
        np.testing.assert_array_equal(again.matrix.data, given.matrix.data)
        np.testing.assert_array_equal(again.near_nullspace, given.near_nullspace)
        check_mesh(replace(level.mesh, source=None))


def test_indices_that_kernels_follow_cannot_be_written(problem):
    """Compiled code would read outside of its arrays; a user's own matrices stay open, as they are copied."""
    grids = am.Hierarchy.uniform(problem, (2, 4, 8))
    discrete = grids.finest.discrete
    given = [sparse.csr_array(level.prolongation, copy=True) for level in grids[1:]]
    bare = am.DiscreteProblem(matrix=discrete.matrix.copy(), load=discrete.load, fixed=discrete.fixed, law=discrete.law,
                              contact=discrete.contact)
    made = am.Hierarchy.from_prolongations(bare, given)
    single = am.Level(bare, prolongation=given[-1])
    for level in (*grids.levels, *made.levels, single):
        for matrix in (level.matrix, level.prolongation, level.surface_prolongation):
            for array in () if matrix is None else (matrix.indices, matrix.indptr):
                with pytest.raises(ValueError, match="read-only"):
                    array[0] = 2**30
    given[-1].indices[0] = 0
