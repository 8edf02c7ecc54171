"""Files for PETSc, read back byte by byte by an independent reader, pose the same problem."""

import dataclasses
import itertools
import json
import struct
from functools import cache

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.export import petsc_files


def read(path):
    """A file in PETSc's documented layout: class id, sizes, then integers of 32 bits and reals of
    64, big-endian."""
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


HIERARCHIES = {
    "bar": lambda: am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 9e-3)),
    "block": lambda: am.Hierarchy.uniform(am.cases.greco_block(), (2, 4)),
    "joint": lambda: am.Hierarchy.graded(am.cases.dovetail(), sizes=(6e-3, 4e-3)),
}


@cache
def made(name):
    return HIERARCHIES[name]()


@pytest.fixture
def bar():
    return made("bar")


def exported(tmp_path, problem):
    """The files of an export by their names, and the manifest."""
    manifest = am.export.petsc(problem, tmp_path / "out")
    assert manifest == tmp_path / "out" / "manifest.json"
    return {path.stem: read(path) for path in manifest.parent.glob("*.petsc")}, json.loads(
        manifest.read_text()
    )


@pytest.mark.parametrize("name", HIERARCHIES)
def test_every_file_holds_the_part_it_is_named_after(tmp_path, name):
    hierarchy = made(name)
    files, manifest = exported(tmp_path, hierarchy)
    dim = hierarchy.finest.discrete.dim
    for k, level in enumerate(hierarchy.levels):
        problem, contact = level.discrete, level.discrete.contact
        np.testing.assert_array_equal(files[f"level{k}_matrix"].toarray(), problem.matrix.toarray())
        assert files[f"level{k}_matrix"].nnz == problem.matrix.nnz
        limit, friction = problem.law.bounds(len(contact))
        for part, wanted in {
            "load": problem.load,
            "fixed_values": problem.fixed_values,
            "fixed": np.flatnonzero(problem.fixed),
            "coordinates": problem.coordinates,
            "contact_nodes": contact.nodes,
            "contact_normals": contact.normals,
            "contact_gaps": contact.gaps,
            "contact_weights": contact.weights,
            "contact_slip_limit": limit,
            "contact_friction": friction,
            "contact_slip_reference": contact.slip_reference,
            "contact_boundary": contact.boundary,
            "mode1": problem.near_nullspace[:, 1],
        }.items():
            np.testing.assert_array_equal(files[f"level{k}_{part}"], np.ravel(wanted), err_msg=part)
        coupled = problem.coupling is not None
        assert (f"level{k}_coupling" in files) == coupled
        if coupled:
            wanted = problem.coupling.physical(np.eye(problem.n_dofs))
            np.testing.assert_array_equal(files[f"level{k}_coupling"].toarray(), wanted)
        for form in ("prolongation", "surface_prolongation"):
            P = vars(level)[form]
            assert (f"level{k}_{form}" in files) == (P is not None)
            if P is not None:
                np.testing.assert_array_equal(
                    files[f"level{k}_{form}"].toarray(), np.kron(P.toarray(), np.eye(dim))
                )
    assert {entry["file"].removesuffix(".petsc") for entry in manifest["files"]} == set(files)
    assert manifest["dim"] == dim and manifest["levels"] == len(hierarchy)


def test_the_manifest_and_the_info_files_say_the_block_sizes(tmp_path):
    _, manifest = exported(tmp_path, made("block"))
    for entry in manifest["files"]:
        info = tmp_path / "out" / f"{entry['file']}.info"
        assert info.exists() == (entry["kind"] != "IS")
        if info.exists():
            assert (
                info.read_text()
                == f"-{entry['kind'].lower()}load_block_size {entry['block_size']}\n"
            )
        blocked = any(
            part in entry["file"]
            for part in (
                "matrix",
                "prolongation",
                "load",
                "values",
                "coordinates",
                "mode",
                "normals",
                "reference",
            )
        )
        assert entry["block_size"] == (3 if blocked else 1)
        assert entry["meaning"] and entry["kind"] in ("Mat", "Vec", "IS")
        size = read(tmp_path / "out" / entry["file"])
        assert entry["size"] == (list(size.shape) if entry["kind"] == "Mat" else len(size))


def test_a_bare_problem_is_one_level_with_its_name(tmp_path, bar):
    odd = dataclasses.replace(bar[0].discrete, name="a{b}%s ü")
    files, manifest = exported(tmp_path, odd)
    assert (
        manifest["levels"] == 1 and "level0_matrix" in files and "level0_prolongation" not in files
    )
    assert manifest["problem"] == "a{b}%s ü"


DENSE = np.random.default_rng(0).random((12, 8)).round() * np.arange(8)
DENSE[4:8] = 0.0


@pytest.mark.parametrize(
    "made",
    [
        *(sparse.bsr_array(DENSE, blocksize=size) for size in ((2, 2), (3, 1), (1, 4))),
        sparse.csr_array(DENSE),
        sparse.csc_array(DENSE),
        sparse.coo_array(DENSE),
        sparse.bsr_array((np.arange(12.0).reshape(3, 2, 2), [1, 0, 1], [0, 3]), shape=(2, 4)),
        sparse.csr_array((np.arange(4.0), [1, 0, 1, 0], [0, 3, 4]), shape=(2, 2)),
    ],
)
def test_any_matrix_comes_back_in_order_and_stays(tmp_path, made):
    before = made.copy()
    (tmp_path / "A").write_bytes(petsc_files.content("A", made))
    np.testing.assert_array_equal(read(tmp_path / "A").toarray(), before.toarray())
    for name in {"data", "indices", "row"} & set(vars(made)):
        np.testing.assert_array_equal(getattr(made, name), getattr(before, name))


def test_more_nonzeros_than_petsc_counts_are_refused(tmp_path, bar, monkeypatch):
    assert petsc_files.LARGEST == 2**31 - 1
    monkeypatch.setattr(petsc_files, "LARGEST", bar.finest.discrete.matrix.nnz - 1)
    with pytest.raises(
        ValueError, match=r"level1_matrix has \d+ values, more than the \d+ that PETSc counts"
    ):
        am.export.petsc(bar, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_folder_is_new_or_empty(tmp_path, bar):
    (tmp_path / "out").mkdir()
    am.export.petsc(bar[0].discrete, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    with pytest.raises(FileExistsError, match="must be a new or empty folder"):
        am.export.petsc(bar, tmp_path / "out")
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_a_full_disk_leaves_nothing(tmp_path, bar, monkeypatch):
    calls, write = [], petsc_files.write_bytes

    def failing(path, content):
        calls.append(path)
        if len(calls) == 9:
            raise OSError(28, "No space left on device")
        write(path, content)

    monkeypatch.setattr(petsc_files, "write_bytes", failing)
    with pytest.raises(OSError, match="No space"):
        am.export.petsc(bar, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_bad_arguments_are_refused(tmp_path, bar):
    (tmp_path / "file").write_text("x")
    for problem, target, error, message in (
        (
            bar.finest.discrete.matrix,
            "out",
            TypeError,
            "problem must be a Hierarchy or a DiscreteProblem",
        ),
        (bar, "nowhere/out", FileNotFoundError, "nowhere"),
        (bar, "file", FileExistsError, "new or empty"),
    ):
        with pytest.raises(error, match=message):
            am.export.petsc(problem, tmp_path / target)
