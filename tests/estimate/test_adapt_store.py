"""The store of an adaptive loop: one broken off ends with the same numbers, other folders are
refused."""

import errno
import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import adaptmg as am

COARSE, NODES, UPSET = 8e-3, 300, am.cases.upset_block()


def loop(store: Path | None, **options: object):
    return am.adapt(
        **{
            "problem": UPSET,
            "start": COARSE,
            "engine": am.Bisect(),
            "max_nodes": NODES,
            "store": store,
        }
        | options
    )


def numbers_of(steps: list[am.Step]) -> list[bytes]:
    """Everything that the steps computed, timings apart."""
    found = []
    for step in steps:
        mesh, work = (
            step.hierarchy.finest.mesh,
            (step.work_units, step.total_work_units, step.result.rtol),
        )
        levels = [level.n_nodes for level in step.hierarchy.levels]
        history = (
            [array.tobytes() for array in vars(mesh.refinement).values()] if mesh.refinement else []
        )
        found.append(
            b"".join(
                [
                    *history,
                    step.result.displacement.tobytes(),
                    step.estimate.squares.tobytes(),
                    mesh.points.tobytes(),
                    mesh.elements.tobytes(),
                    np.array(work).tobytes(),
                    np.array(levels).tobytes(),
                ]
            )
        )
    return found


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def whole(kept) -> list[am.Step]:
    """The steps of a loop that is not broken off, in ``kept``."""
    return list(loop(kept))


@pytest.fixture
def copied(kept, whole, tmp_path) -> Path:
    return Path(shutil.copytree(kept, tmp_path / "store"))


#: the number of steps before a loop is broken off, and its options
KINDS = {
    "after a step": (1, {}),
    "after three": (3, {}),
    "levels": (
        2,
        {"problem": UPSET, "start": am.Hierarchy.uniform(UPSET, (2, 3, 6)), "max_nodes": 200},
    ),
    "scalar": (1, {"problem": am.cases.obstacle_problem(), "start": 0.3}),
    "goal": (
        1,
        {"start": 10e-3, "indicator": am.Goal(am.Displacement((0.0, 0.02), "x")), "max_nodes": 90},
    ),
    "path": (
        1,
        {
            "problem": am.cases.greco_bar(),
            "start": 10e-3,
            "adapt_on": "worst",
            "max_nodes": 90,
            "load_path": am.LoadPath({"left": [0.5, 1.0]}, default=1.0),
        },
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_that_is_broken_off_goes_on_with_the_same_numbers(tmp_path, kind, whole):
    done, options = KINDS[kind]
    once = list(loop(None, **options)) if options else whole
    mine = tmp_path / "path_0000" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("x")
    list(itertools.islice(loop(tmp_path, **options), done))
    solved = []
    again = list(
        loop(
            tmp_path,
            **options,
            progress=lambda row: solved.append(row["step"]) if row["phase"] == "solve" else None,
        )
    )
    assert numbers_of(again) == numbers_of(once) and set(solved) == set(range(done, len(once)))
    assert again[-1].outcome.startswith("max_nodes")
    assert [repr(step.estimate) for step in again] == [repr(step.estimate) for step in once]
    assert [step.path and len(step.path) for step in again] == [
        step.path and len(step.path) for step in once
    ]
    assert mine.exists()


def test_a_step_that_is_there_is_not_written_again(tmp_path):
    (tmp_path / "a").mkdir()
    steps = loop(tmp_path / "a")
    next(steps)
    (tmp_path / "a" / "step_0001.npz").write_bytes(b"mine")
    with pytest.raises(ValueError, match=r"step_0001\.npz is damaged"):
        list(steps)
    assert (tmp_path / "a" / "step_0001.npz").read_bytes() == b"mine"
    # another process may store the same steps
    both = [loop(tmp_path / "b"), loop(tmp_path / "b")]
    assert all(numbers_of([a]) == numbers_of([b]) for a, b in zip(*both, strict=True))


def test_a_finished_loop_is_read_not_made_again(kept, whole):
    found = list(loop(kept))
    assert [step.result.timings for step in found] == [step.result.timings for step in whole]
    assert numbers_of(found) == numbers_of(whole) and found[-1].outcome
    assert found[0].estimate.terms
    assert found[1].hierarchy[0] is found[0].hierarchy[0]


def test_limits_may_change(copied, whole):
    further = list(loop(copied, max_nodes=500))
    assert numbers_of(further)[: len(whole) - 1] == numbers_of(whole)[:-1] and len(further) > len(
        whole
    )
    assert len(list(loop(copied, max_nodes=100))) == len(further)  # what is there stays


@pytest.mark.parametrize(
    "what, options",
    [
        ("engine", {"engine": am.Remesh()}),
        ("mark", {"mark": am.Doerfler(0.3)}),
        ("indicator", {"indicator": am.Recovery()}),
        ("solver", {"solver": am.Multigrid()}),
        ("transfer", {"transfer": am.L2()}),
        ("grids", {"start": 7e-3}),
        ("law", {"problem": am.cases.upset_block(law=am.Coulomb(0.4))}),
        ("path", {"load_path": am.LoadPath({}, default=[0.5, 1.0])}),
    ],
)
@pytest.mark.usefixtures("whole")
def test_a_store_of_something_else_is_refused(kept, what, options):
    with pytest.raises(ValueError, match=f"another run.*{what}"):
        loop(kept, **options)


class Some:
    """Marks a share of the elements; neither its repr nor its class tells which."""

    def __init__(self, share: object) -> None:
        self.share = share

    def mark(self, estimate: am.Estimate):
        return am.Doerfler(0.5 if isinstance(self.share, np.random.Generator) else self.share).mark(
            estimate
        )


def test_laws_and_parts_of_the_user_are_compared_by_value(tmp_path):
    """A friction of other values between the nodes of the first mesh was answered with 4.12e-5 for
    4.18e-5."""

    def run(bump: float = 0.0, share: object = 0.5, folder: str = "a", **options: object):
        law = am.Coulomb(lambda x: 0.5 + bump * np.sin(np.pi * x[:, 0] / COARSE) ** 2)
        return loop(
            tmp_path / folder,
            problem=am.cases.upset_block(law=law),
            mark=Some(share),
            max_nodes=60,
            **options,
        )

    assert numbers_of(list(run())) == numbers_of(list(run()))
    with pytest.raises(ValueError, match=r"another run: .*bump"):
        run(bump=-0.3)
    with pytest.raises(ValueError, match="another run: value of mark differs"):
        run(share=0.4)
    with pytest.raises(
        TypeError, match=r"value of mark, which cannot be compared .*depends=\{'mark': \.\.\.\}"
    ):
        run(share=np.random.default_rng(0))
    with pytest.raises(TypeError, match="depends must map names"):
        run(depends=3)
    named = [
        list(run(share=np.random.default_rng(0), folder="b", depends={"mark": 1})) for _ in range(2)
    ]
    assert numbers_of(named[0]) == numbers_of(named[1])
    with pytest.raises(ValueError, match="another run: depends mark differs"):
        run(share=np.random.default_rng(0), folder="b", depends={"mark": 2})


def rewritten(file: Path, **changes: object) -> None:
    with np.load(file) as archive:
        arrays = dict(archive)
    meta = json.loads(arrays.pop("meta").tobytes())
    meta["more"]["StoredStep"] |= changes
    np.savez(file, **arrays, meta=np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8))


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda file: file.write_bytes(file.read_bytes()[:-10]), "is damaged"),
        (lambda file: rewritten(file, levels=[]), "is not what was written"),
        (
            lambda file: shutil.copy(file.with_name("step_0000.npz"), file),
            "another computation|holds step 0",
        ),
        (lambda file: am.Result.load(file).save(file), "another computation"),
    ],
)
def test_a_damaged_or_foreign_step_is_named_and_made_again(copied, whole, change, message):
    change(copied / "step_0001.npz")
    with pytest.raises(ValueError, match=rf"step_0001\.npz.*({message}).*remove it"):
        list(loop(copied))
    for file in sorted(copied.glob("step_*"))[1:]:
        file.unlink()
    assert numbers_of(list(loop(copied))) == numbers_of(whole)


def test_a_full_disk_is_said_with_the_file(tmp_path, monkeypatch):
    steps = loop(tmp_path)
    next(steps)

    def full(*arguments: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with (
        monkeypatch.context() as patch,
        pytest.raises(OSError, match=r"No space left on device: '.*step_0001\.npz'"),
    ):
        patch.setattr("os.fsync", full)
        next(steps)
    assert [file.name for file in tmp_path.glob("*0001*")] == []
    assert len(list(loop(tmp_path))) > 1
