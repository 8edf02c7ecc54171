"""Files for PETSc: read back by a reader of their own, byte by byte, they pose and solve the same problem."""

from __future__ import annotations

import dataclasses
import itertools
import json
import struct

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

import adaptmg as am
from adaptmg import _files as atomic
from adaptmg.export import petsc_files as binary
from adaptmg.export import petsc_files as folder


def read(path):
    """A file by PETSc's documented layout: class id, sizes, then integers of 32 bits and reals of 64, big-endian."""
    data = path.read_bytes()
    kind, first = struct.unpack(">ii", data[:8])
    if kind == 1211214:
        assert len(data) == 8 + 8 * first
        return np.frombuffer(data, ">f8", first, 8).astype(float)
    if kind == 1211218:
        assert len(data) == 8 + 4 * first
        return np.frombuffer(data, ">i4", first, 8).astype(int)
    assert kind == 1211216
    columns, nonzeros = struct.unpack(">ii", data[8:16])
    counts = np.frombuffer(data, ">i4", first, 16)
    assert counts.sum() == nonzeros and len(data) == 16 + 4 * first + 12 * nonzeros
    indices = np.frombuffer(data, ">i4", nonzeros, 16 + 4 * first).astype(int)
    values = np.frombuffer(data, ">f8", nonzeros, 16 + 4 * first + 4 * nonzeros).astype(float)
    pointers = np.concatenate([[0], np.cumsum(counts)])
    for begin, end in itertools.pairwise(pointers):
        assert (np.diff(indices[begin:end]) > 0).all()
    return sparse.csr_array((values, indices, pointers), shape=(first, columns))


@pytest.fixture(scope="module")
def bar():
    return am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 9e-3))


@pytest.fixture(scope="module")
def block():
    return am.Hierarchy.uniform(am.cases.greco_block(), (2, 4))


@pytest.fixture(scope="module")
def joint():
    return am.Hierarchy.graded(am.cases.dovetail(), sizes=(6e-3, 4e-3))


def exported(tmp_path, problem):
    """The files of an export by their names, and the manifest."""
    manifest = am.export.petsc(problem, tmp_path / "out")
    assert manifest == tmp_path / "out" / "manifest.json"
    return {path.stem: read(path) for path in manifest.parent.glob("*.petsc")}, json.loads(manifest.read_text())


@pytest.mark.parametrize("name", ["bar", "block", "joint"])
def test_every_file_holds_what_the_hierarchy_has(tmp_path, request, name):
    hierarchy = request.getfixturevalue(name)
    files, manifest = exported(tmp_path, hierarchy)
    dim = hierarchy.finest.discrete.dim
    for k, level in enumerate(hierarchy.levels):
        problem, contact = level.discrete, level.discrete.contact
        np.testing.assert_array_equal(files[f"level{k}_matrix"].toarray(), problem.matrix.toarray())
        assert files[f"level{k}_matrix"].nnz == problem.matrix.nnz
        limit, friction = problem.law.bounds(len(contact))
        for part, wanted in {"load": problem.load, "fixed_values": problem.fixed_values,
                             "fixed": np.flatnonzero(problem.fixed), "coordinates": problem.coordinates,
                             "contact_nodes": contact.nodes, "contact_normals": contact.normals,
                             "contact_gaps": contact.gaps, "contact_weights": contact.weights,
                             "contact_slip_limit": limit, "contact_friction": friction,
                             "contact_slip_reference": contact.slip_reference,
                             "contact_boundary": contact.boundary, "mode1": problem.near_nullspace[:, 1]}.items():
            np.testing.assert_array_equal(files[f"level{k}_{part}"], np.ravel(wanted), err_msg=part)
        for form in ("prolongation", "surface_prolongation"):
            P = getattr(level, form)
            assert (f"level{k}_{form}" in files) == (P is not None)
            if P is not None:
                np.testing.assert_array_equal(files[f"level{k}_{form}"].toarray(),
                                              np.kron(P.toarray(), np.eye(dim)))
    assert {entry["file"].removesuffix(".petsc") for entry in manifest["files"]} == set(files)
    assert manifest["dim"] == dim and manifest["levels"] == len(hierarchy)


def test_the_manifest_and_the_info_files_say_the_block_sizes(tmp_path, block):
    _, manifest = exported(tmp_path, block)
    for entry in manifest["files"]:
        info = tmp_path / "out" / f"{entry['file']}.info"
        # of blocks of 1 too: what PETSc reads in one of these files holds for all that it loads later
        assert info.exists() == (entry["kind"] != "IS")
        if info.exists():
            assert info.read_text() == f"-{entry['kind'].lower()}load_block_size {entry['block_size']}\n"
        blocked = any(part in entry["file"] for part in ("matrix", "prolongation", "load", "values", "coordinates",
                                                         "mode", "normals", "reference"))
        assert entry["block_size"] == (3 if blocked else 1)
        assert entry["meaning"] and entry["kind"] in ("Mat", "Vec", "IS")
        size = read(tmp_path / "out" / entry["file"])
        assert entry["size"] == (list(size.shape) if entry["kind"] == "Mat" else len(size))
    text = (tmp_path / "out" / "README.txt").read_text()
    assert all(entry["file"].removesuffix(".petsc") in text for entry in manifest["files"])


def test_a_linear_problem_is_solved_from_the_files(tmp_path, bar):
    files, _ = exported(tmp_path, bar)
    discrete, top = bar.finest.discrete, f"level{len(bar) - 1}_"
    nodes, dim = files[f"{top}contact_nodes"], 2
    # contact nodes held too: the linear problem that am.AMG solves elsewhere
    held = np.union1d(files[f"{top}fixed"], (dim * nodes[:, None] + np.arange(dim)).ravel())
    free = np.setdiff1d(np.arange(len(files[f"{top}load"])), held)
    A, u = files[f"{top}matrix"], files[f"{top}fixed_values"].copy()
    u[free] = spsolve(sparse.csc_array(A[free][:, free]), (files[f"{top}load"] - A @ u)[free])
    fixed = discrete.fixed.copy().reshape(-1, dim)
    fixed[discrete.contact.nodes] = True
    fixed = fixed.ravel()
    dense, wanted = discrete.matrix.toarray(), np.where(discrete.fixed, discrete.fixed_values, 0.0)
    wanted[~fixed] = np.linalg.solve(dense[~fixed][:, ~fixed], (discrete.load - dense @ wanted)[~fixed])
    assert np.abs(u - wanted).max() < 1e-9 * np.abs(wanted).max()
    # and the Galerkin coarse matrix of the files keeps rigid motions without energy
    P = files[f"{top}prolongation"]
    coarse = P.T @ A @ P
    mode = files[f"level{len(bar) - 2}_mode0"]
    assert abs(mode @ (coarse @ mode)) < 1e-9 * abs(coarse).max()


def test_the_contact_solution_satisfies_the_conditions_in_the_files(tmp_path, joint):
    result = am.solve(joint, am.FullMultigrid(rtol=1e-9))
    files, manifest = exported(tmp_path, joint)
    top, n = f"level{len(joint) - 1}_", joint.finest.n_nodes
    T = files[f"{top}coupling"]
    w = spsolve(sparse.csc_array(T), result.displacement.ravel())
    r = (files[f"{top}matrix"] @ w - files[f"{top}load"]).reshape(n, 2)
    nodes, normals = files[f"{top}contact_nodes"], files[f"{top}contact_normals"].reshape(-1, 2)
    gap = files[f"{top}contact_gaps"] - np.einsum("nd,nd->n", w.reshape(n, 2)[nodes], normals)
    p = -np.einsum("nd,nd->n", r[nodes], normals)
    friction = np.linalg.norm(r[nodes] + p[:, None] * normals, axis=1)
    force, length = np.abs(p).max(), np.abs(result.displacement).max()
    assert p.min() > -1e-6 * force and gap.min() > -1e-6 * length and np.abs(p * gap).max() < 1e-6 * force * length
    bound = files[f"{top}contact_slip_limit"] + files[f"{top}contact_friction"] * p
    # a support holds the other component of the others
    free = ~np.isin(2 * nodes[:, None] + [0, 1], files[f"{top}fixed"]).any(axis=1)
    assert free.sum() > 5 and (friction[free] <= bound[free] + 1e-6 * force).all()
    assert "relative to the other body" in (tmp_path / "out" / "README.txt").read_text()
    others = np.setdiff1d(np.arange(2 * n), np.union1d(files[f"{top}fixed"], (2 * nodes[:, None] + [0, 1]).ravel()))
    assert np.abs(r.ravel()[others]).max() < 1e-6 * force
    assert manifest["contact_boundaries"]


def test_coarse_spaces_without_a_problem(tmp_path, bar):
    algebraic = am.Hierarchy.algebraic(bar.finest.discrete, max_coarse=20)
    files, _ = exported(tmp_path, algebraic)
    assert len(algebraic) > 1 and "level0_load" not in files
    for k, level in enumerate(algebraic.levels):
        np.testing.assert_array_equal(files[f"level{k}_matrix"].toarray(), level.matrix.toarray())
        if k:
            assert files[f"level{k}_prolongation"].shape == (level.matrix.shape[0],
                                                             algebraic[k - 1].matrix.shape[0])


def test_a_bare_problem_is_one_level(tmp_path, bar):
    files, manifest = exported(tmp_path, bar[0].discrete)
    assert manifest["levels"] == 1 and "level0_matrix" in files and "level0_prolongation" not in files


@pytest.mark.parametrize("make", [
    lambda A: sparse.bsr_array(A, blocksize=(2, 2)), lambda A: sparse.bsr_array(A, blocksize=(3, 1)),
    lambda A: sparse.bsr_array(A, blocksize=(1, 4)), sparse.csr_array, sparse.csc_array, sparse.coo_array])
def test_any_matrix_comes_back(tmp_path, make):
    rng = np.random.default_rng(0)
    dense = rng.random((12, 8)) * (rng.random((12, 8)) < 0.3)
    dense[4:8] = 0.0
    made = make(dense)
    (tmp_path / "A").write_bytes(binary.matrix("A", made))
    np.testing.assert_array_equal(read(tmp_path / "A").toarray(), dense)


def test_unsorted_and_doubled_entries_are_put_in_order_and_the_matrix_is_left_alone(tmp_path):
    made = sparse.bsr_array((np.arange(12.0).reshape(3, 2, 2), [1, 0, 1], [0, 3]), shape=(2, 4))
    before = made.data.copy(), made.indices.copy(), made.toarray()
    (tmp_path / "A").write_bytes(binary.matrix("A", made))
    np.testing.assert_array_equal(read(tmp_path / "A").toarray(), before[2])
    np.testing.assert_array_equal(made.data, before[0])
    np.testing.assert_array_equal(made.indices, before[1])


def test_more_nonzeros_than_petsc_counts_are_refused_and_nothing_is_written(tmp_path, bar, monkeypatch):
    monkeypatch.setattr(binary, "LARGEST", bar.finest.discrete.matrix.nnz - 1)
    with pytest.raises(ValueError, match=r"level1_matrix has \d+ nonzeros, more than the \d+ that PETSc counts"):
        am.export.petsc(bar, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_2_to_the_31_nonzeros_are_too_many():
    huge = sparse.csr_array((1, 1))

    class Huge:
        shape, nnz, format = huge.shape, 2**31, "csr"

    with pytest.raises(ValueError, match="2147483648 nonzeros, more than the 2147483647"):
        binary.matrix("A", Huge())


def test_an_older_export_is_replaced_and_anything_else_is_left(tmp_path, bar):
    target = tmp_path / "out"
    am.export.petsc(bar, target)
    am.export.petsc(bar[0].discrete, target)
    assert not list(target.glob("level1*")) and len(list(tmp_path.iterdir())) == 1
    (target / "mine.txt").write_text("kept")
    before = {path.name: path.read_bytes() for path in target.iterdir()}
    with pytest.raises(FileExistsError, match=r"holds other files, 'mine.txt' for one"):
        am.export.petsc(bar, target)
    assert {path.name: path.read_bytes() for path in target.iterdir()} == before
    (tmp_path / "empty").mkdir()
    am.export.petsc(bar[0].discrete, tmp_path / "empty")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "manifest.json").write_text("[1]")
    with pytest.raises(FileExistsError):
        am.export.petsc(bar[0].discrete, tmp_path / "damaged")


def test_a_full_disk_leaves_what_was_there(tmp_path, bar, monkeypatch):
    am.export.petsc(bar[0].discrete, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    calls = []

    def failing(path, content):
        calls.append(path)
        if len(calls) == 9:
            raise OSError(28, "No space left on device")
        atomic.write_bytes(path, content)

    monkeypatch.setattr(folder, "write_bytes", failing)
    for name in ("out", "new"):
        calls.clear()
        with pytest.raises(OSError, match="No space"):
            am.export.petsc(bar, tmp_path / name)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_it_checks_what_it_is_given(tmp_path, bar):
    with pytest.raises(TypeError, match="problem must be a Hierarchy or a DiscreteProblem"):
        am.export.petsc(bar.finest.discrete.matrix, tmp_path / "out")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        am.export.petsc(bar, tmp_path / "nowhere" / "out")
    (tmp_path / "file").write_text("x")
    with pytest.raises(NotADirectoryError, match="is a file"):
        am.export.petsc(bar, tmp_path / "file")
    with pytest.raises((TypeError, ValueError)):
        am.export.petsc(bar, "")


def test_a_name_is_written_as_it_is(tmp_path, bar):
    odd = dataclasses.replace(bar.finest.discrete, name="a{b}%s ü")
    _, manifest = exported(tmp_path, odd)
    assert manifest["problem"] == "a{b}%s ü" and "a{b}%s ü" in (tmp_path / "out" / "README.txt").read_text()
