"""The history of a mesh goes through files, and what does not fit is refused."""

import numpy as np
import pytest
from bisected_meshes import SQUARE, as_sets, crooked, cube, random_mask

import adaptmg as am
from adaptmg.mesh import MeshArrays, bisect, check_mesh, coarsen, structured
from adaptmg.mesh.bisection.tables import history_arrays, with_history

MESHES = {"2D": crooked(SQUARE), "3D": crooked(cube(2))}


def bisected(mesh):
    for k in range(3):
        mesh, _ = bisect(mesh, random_mask(mesh, 0.2, k), passes=2)
    return mesh


def bare(mesh):
    """What a file keeps of a mesh."""
    return check_mesh(MeshArrays(mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries,
                                 mesh.element_body, mesh.bodies))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_bisection_goes_on_from_a_file_as_if_it_had_never_stopped(mesh, tmp_path):
    fine = bisected(mesh)
    np.savez(tmp_path / "history.npz", **history_arrays(fine))
    with np.load(tmp_path / "history.npz") as arrays:
        back = with_history(bare(fine), arrays)
    marked = random_mask(fine, 0.3, 9)
    first, second = (bisect(m, marked)[0] for m in (fine, back))
    for name in ("points", "elements", "facets", "facet_labels"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert as_sets(coarsen(second, np.ones(len(second.elements), dtype=bool))) == as_sets(mesh)
    # without it, the mesh is an initial one
    assert coarsen(bare(fine), np.ones(len(fine.elements), dtype=bool)).n_nodes == fine.n_nodes
    assert history_arrays(mesh) == {} and with_history(bare(fine), {}).refinement is None


def test_a_result_keeps_the_mesh_without_its_history(tmp_path):
    problem = am.cases.greco_bar()
    mesh, _ = bisect(structured(problem.domain, 4), np.arange(32) < 5)
    result = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), am.SingleGrid())
    assert result.mesh.refinement is not None
    result.save(tmp_path / "run.npz")
    read = am.Result.load(tmp_path / "run.npz").mesh
    np.testing.assert_array_equal(read.elements, mesh.elements)
    assert read.refinement is None


def spoilt(arrays, name, change):
    if change is None:
        return {key: array for key, array in arrays.items() if key != name}
    return {**arrays, name: change(np.array(arrays[name]))}


def put(row, value):
    def change(array):
        array[row] = value
        return array
    return change


@pytest.mark.parametrize(("name", "change", "message"), [
    ("parents", lambda a: a[:-1], "parents must have shape"),
    ("parents", put((0, 1), 5), "parents holds numbers out of range"),
    ("marks", put(0, 18), "marks holds numbers out of range"),
    ("forebear", put(0, 10**6), "forebear holds numbers out of range"),
    ("forebear", lambda a: np.where(a >= 0, (a + 3) % (a.max() + 1), a), "elements lack the node"),
    ("tree", put((0, 0), 10**6), "tree holds numbers out of range"),
    ("tree", lambda a: a[:, :-1], "tree must have shape"),
    ("marks", lambda a: a.astype(np.int64) + 2**40, "marks holds numbers out of range"),
    ("marks", None, "history: marks is missing"),
])
def test_what_does_not_fit_is_refused(name, change, message):
    fine = bisected(MESHES["3D"])
    with pytest.raises(ValueError, match=message):
        with_history(bare(fine), spoilt(history_arrays(fine), name, change))
