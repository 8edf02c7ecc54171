"""Hierarchies: constructors, the table, and what is refused."""

import pickle
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.mesh import check_mesh

COARSE = am.mesh.structured(am.cases.greco_bar().domain, 4)


@pytest.fixture(scope="module")
def problem():
    return am.cases.greco_bar()


class Nearest:
    """Values of the nearest coarse node, of whatever body."""

    def build(self, coarse, fine):
        near = np.argmin(np.linalg.norm(fine.points[:, None] - coarse.points, axis=2), axis=1)
        return sparse.csr_array((np.ones(fine.n_nodes), (np.arange(fine.n_nodes), near)),
                                shape=(fine.n_nodes, coarse.n_nodes))


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
        if "bisected" in grids.origin:
            n = coarse.mesh.n_nodes
            assert np.array_equal(fine.mesh.points[:n], coarse.mesh.points)
            assert abs(fine.prolongation[:n] - sparse.eye_array(n)).max() < 1e-12
            assert len(fine.discrete.contact) > 1.5 * len(coarse.discrete.contact)


def test_sizes_have_defaults_that_follow_bodies_and_contact():
    bar = am.Hierarchy.graded(am.cases.greco_bar())
    assert [level.n_nodes for level in bar] == sorted(level.n_nodes for level in bar) and len(bar) == 3
    assert 32 <= len(bar.finest.discrete.contact) <= 128
    assert bar.finest.mesh.element_sizes.max() == pytest.approx(40e-3 / 16, rel=0.5)
    plain = am.Hierarchy.graded(am.cases.greco_bar(), contact_ratio=1)
    assert len(plain.finest.discrete.contact) < len(bar.finest.discrete.contact) / 2


def test_paper_grids(problem):
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8, 16, 32))
    assert [row["nodes"] for row in grids.table()] == [25, 81, 289, 1089]
    assert all(text in repr(grids) for text in ("1089", "GRECO", f"{grids.operator_complexity:.3f}"))
    assert set(grids.timings) == {"mesh", "assembly", "transfer"} and min(grids.timings.values()) > 0
    assert grids.grid_complexity == pytest.approx((25 + 81 + 289 + 1089) / 1089)
    part = grids.truncated(coarsest=1, finest=2)
    assert [row["nodes"] for row in part.table()] == [81, 289]
    with pytest.raises(AttributeError, match="the coarsest level has no prolongation"):
        _ = part[0].prolongation
    with pytest.raises(ValueError, match="coarsest and finest"):
        grids.truncated(coarsest=2, finest=1)


def test_contact_rows_stay_on_the_contact_boundary(problem):
    sizes = (20e-3, 8e-3)
    grids = am.Hierarchy.graded(problem, sizes=sizes, transfer=Nearest())
    contact = grids[1].discrete.contact.nodes
    x = affine(grids[1].mesh.points)
    found = grids[1].prolongation @ affine(grids[0].mesh.points)
    assert found[contact] == pytest.approx(x[contact], rel=1e-12)
    assert np.abs(found - x).max() > 1e-3
    untouched = am.Hierarchy.graded(problem, sizes=sizes, transfer=Nearest(), contact_rows=False)
    assert (np.diff(untouched[1].prolongation.indptr) == 1).all()


RENAMED = replace(COARSE, boundaries=("south", "east", "north", "west"), source=None)
BLOCKS = [am.mesh.structured(am.Box(width=1, depth=1, height=1), n) for n in (2, 4)]


def _with_a_wrong_prolongation(problem):
    first, second = am.Hierarchy.uniform(problem, divisions=(2, 4)).levels
    return am.Hierarchy((first, am.Level(second.discrete, second.mesh, sparse.eye_array(3, format="csr"))))


@pytest.mark.parametrize(("call", "error", "message"), [
    (lambda p: am.Hierarchy.uniform(replace(p, domain=None), divisions=(2, 4)), ValueError, "domain is None"),
    (lambda p: am.Hierarchy.graded(p, (20e-3, 10e-3), transfer="interpolation"), TypeError,
     "transfer must be a transfer, which offers build"),
    (lambda p: am.Hierarchy(()), ValueError, "levels is empty"),
    (lambda p: am.Hierarchy.graded(p, (20e-3, 10e-3), transfer=SimpleNamespace(
        build=lambda coarse, fine: sparse.eye_array(3))), ValueError, "must return a matrix of shape"),
    (_with_a_wrong_prolongation, ValueError, "prolongation must have shape"),
    (lambda p: am.Hierarchy.from_meshes(p, RENAMED), ValueError, "'bottom', used for contact, does not exist"),
    (lambda p: am.Hierarchy.from_meshes(p, BLOCKS), ValueError, "3D"),
    # bodies that touch have nodes at the same places
    (lambda p: am.Hierarchy.graded(am.cases.dovetail(), (10e-3, 6e-3), contact_ratio=2, transfer=Nearest()), ValueError,
     r"lets node \d+ of body '\w+' follow body '\w+': build the rows of each body"),
])
def test_refusals(problem, call, error, message):
    with pytest.raises(error, match=message):
        call(problem)


def test_nothing_is_made_that_nobody_asked_for(problem, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("made without being asked for")

    for name in ("mesh.ngsolve_bridge.to_ngsolve", "mesh.soundness.facet_table", "transfer.mesh_ratio",
                 "discrete.discretise.rigid_motions"):
        module, name = name.rsplit(".", 1)
        monkeypatch.setattr(import_module(f"adaptmg.{module}"), name, refuse)
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4, 8))
    mesh, discrete = grids.finest.mesh, grids.finest.discrete
    for asked in (lambda: mesh.source, lambda: discrete.near_nullspace, lambda: repr(grids)):
        with pytest.raises(AssertionError, match="without being asked"):
            asked()
    monkeypatch.undo()
    assert mesh.source is mesh.source and mesh.source.nv == 81 and grids[1].mesh_ratio == pytest.approx(2)
    assert discrete.near_nullspace is discrete.near_nullspace and discrete.near_nullspace.shape == (162, 3)
    back = pickle.loads(pickle.dumps(am.Hierarchy.uniform(problem, divisions=(2, 4, 8))))
    np.testing.assert_array_equal(back.finest.discrete.near_nullspace, discrete.near_nullspace)
    assert back[1].mesh_ratio == pytest.approx(2)


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
        for matrix in (level.matrix, getattr(level, "prolongation", None), level.surface_prolongation):
            for array in () if matrix is None else (matrix.indices, matrix.indptr):
                with pytest.raises(ValueError, match="read-only"):
                    array[0] = 2**30
    given[-1].indices[0] = 0


def _same_levels(a: am.Hierarchy, b: am.Hierarchy) -> None:
    for one, two in zip(a.levels, b.levels, strict=True):
        matrices = [(level.matrix, getattr(level, "prolongation", None), level.surface_prolongation)
                    for level in (one, two)]
        for x, y in zip(*matrices, strict=True):
            assert (x is None) == (y is None)
            for part in () if x is None else ("indptr", "indices", "data"):
                np.testing.assert_array_equal(getattr(x, part), getattr(y, part))
        n = len(one.discrete.contact)
        np.testing.assert_array_equal(one.discrete.law.bounds(n), two.discrete.law.bounds(n))
        for name in ("load", "fixed", "fixed_values"):
            np.testing.assert_array_equal(getattr(one.discrete, name), getattr(two.discrete, name))
        for name in ("nodes", "normals", "gaps", "weights", "boundary", "slip_reference"):
            np.testing.assert_array_equal(getattr(one.discrete.contact, name), getattr(two.discrete.contact, name))


def test_another_problem_on_the_same_meshes_is_what_building_anew_makes():
    bar = am.cases.greco_bar
    springs = [am.Symmetry("left"), am.Spring("right", normal=1e9)]
    joint = am.cases.dovetail()
    stiffer = {name: am.PlaneStrain(young=3e11, poisson=0.3) for name in joint.bodies}
    for first, others in ((bar(), (bar(law=am.Coulomb(0.2)), bar(top_pressure=1e7), bar(young=1e11),
                                   replace(bar(), supports=springs), replace(bar(), law=am.Frictionless()))),
                          (joint, (replace(joint, law=am.Coulomb(0.7)), replace(joint, law=am.Frictionless()),
                                   replace(joint, material=stiffer)))):
        old = am.Hierarchy.graded(first, (first.domain.upper.max() / 4, first.domain.upper.max() / 8))
        for k, other in enumerate(others):
            new = old.with_problem(other)
            _same_levels(new, am.Hierarchy.from_meshes(other, [level.mesh for level in old.levels]))
            assert new.problem is other and new.finest.prolongation is old.finest.prolongation
            assert k > 0 or new.finest.matrix is old.finest.matrix
    with pytest.raises(ValueError, match="another domain, Rectangle"):
        old.with_problem(bar())
    with pytest.raises(ValueError, match=r"contact on .*, but these meshes were made for contact on"):
        old.with_problem(replace(joint, contact=am.Contact(joint.contact_boundaries[0], am.Plane((0, 0), (0, 1)))))
    with pytest.raises(ValueError, match=r"with_problem: these levels .* are not made of meshes"):
        am.Hierarchy.single(old.finest.discrete).with_problem(joint)
