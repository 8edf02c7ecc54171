"""The store of an adaptive loop: what was killed goes on and ends with the same numbers, other folders are refused."""

from __future__ import annotations

import errno
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from adaptive_loop import numbers_of, upset

import adaptmg as am

COARSE, NODES = 8e-3, 500
#: a loop in another process; it is killed from outside, or by itself at the n-th file that it writes
CHILD = """
import os, signal, sys
import adaptmg as am
from adaptmg.estimate import loop_store as store
from adaptmg.solver import result_file
folder, engine, at = sys.argv[1], eval(sys.argv[2]), int(sys.argv[3])
written = 0
def counted(path, content, write=store.write_bytes):
    global written
    written += 1
    if written == at:
        os.kill(os.getpid(), signal.SIGKILL)
    write(path, content)
store.write_bytes = result_file.write_bytes = counted
problem = am.cases.upset_block(law=am.Coulomb(0.5))
for step in am.adapt(problem, 8e-3, engine=engine, max_nodes=500, store=folder):
    print(step.number, flush=True)
"""


def loop(store: Path | None, engine: object = None, **options: object):
    options = {"max_nodes": NODES} | options
    return am.adapt(upset(), COARSE, engine=am.Bisect() if engine is None else engine, store=store, **options)


@pytest.fixture(scope="module")
def whole() -> list[bytes]:
    return numbers_of(list(loop(None)))


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    list(loop(folder))
    return folder


@pytest.fixture
def copied(kept, tmp_path) -> Path:
    return Path(shutil.copytree(kept, tmp_path / "store"))


@pytest.mark.parametrize("done", [0, 1, 3])
def test_a_loop_that_is_broken_off_goes_on_with_the_same_numbers(tmp_path, whole, done):
    list(itertools.islice(loop(tmp_path), done))
    solved = []
    found = list(loop(tmp_path, progress=lambda row: solved.append(row["step"]) if row["phase"] == "solve" else None))
    assert numbers_of(found) == whole
    assert solved == list(range(done, len(whole)))
    assert found[-1].outcome.startswith("max_nodes")


@pytest.mark.parametrize("engine", [am.Remesh(refinements=0), am.Bisect(coarsen=0.05)])
def test_every_engine_goes_on_with_the_same_numbers(tmp_path, engine):
    once = numbers_of(list(loop(None, engine, max_nodes=300)))
    list(itertools.islice(loop(tmp_path, engine, max_nodes=300), 2))
    assert numbers_of(list(loop(tmp_path, engine, max_nodes=300))) == once


def test_a_finished_loop_is_read_not_made_again(kept, whole, monkeypatch):
    monkeypatch.setattr("adaptmg.estimate.loop.solved", lambda *a: pytest.fail("solved again"))
    found = list(loop(kept))
    assert numbers_of(found) == whole and found[-1].outcome
    assert found[0].estimate.terms
    assert found[1].hierarchy[0] is found[0].hierarchy[0]


@pytest.mark.parametrize("at", [2, 6])
def test_a_loop_killed_while_it_writes_goes_on_with_the_same_numbers(tmp_path, whole, at):
    child = [sys.executable, "-c", CHILD, str(tmp_path), "am.Bisect()", str(at)]
    assert subprocess.run(child, capture_output=True).returncode == -signal.SIGKILL
    assert numbers_of(list(loop(tmp_path))) == whole


def test_a_loop_killed_from_outside_goes_on_with_the_same_numbers(tmp_path, whole):
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path), "am.Bisect()", "-1"],
                             stdout=subprocess.PIPE, text=True)
    with child:
        assert child.stdout.readline() == "0\n"
        time.sleep(0.02)
        child.kill()
    assert numbers_of(list(loop(tmp_path))) == whole


def test_levels_that_were_put_between_or_given_at_the_start_come_back(tmp_path):
    problem = upset()

    def run(store):
        return am.adapt(problem, am.Hierarchy.uniform(problem, (2, 3, 6)), engine=am.Bisect(), max_nodes=200,
                        store=store)

    once = numbers_of(list(run(None)))
    list(itertools.islice(run(tmp_path), 2))
    assert numbers_of(list(run(tmp_path))) == once


def test_goals_come_back_with_all_they_say(tmp_path):
    problem, goal = upset(), am.Goal(am.Displacement((0.0, 0.02), "x"))

    def run(**options):
        return am.adapt(problem, 10e-3, goal, engine=am.Bisect(), max_nodes=90, **options)

    once = list(run())
    next(run(store=tmp_path))
    again = list(run(store=tmp_path))
    assert numbers_of(again) == numbers_of(once)
    assert [repr(step.estimate) for step in again] == [repr(step.estimate) for step in once]
    assert again[0].estimate.corrected == pytest.approx(once[0].estimate.corrected, abs=0)


def test_a_load_path_is_kept(tmp_path):
    problem, path = am.cases.greco_bar(), am.LoadPath({"left": [0.5, 1.0]}, default=1.0)

    def run(**options):
        return am.adapt(problem, 10e-3, engine=am.Bisect(), load_path=path, adapt_on="worst", max_nodes=90,
                        **options)

    once = list(run())
    next(run(store=tmp_path))
    again = list(run(store=tmp_path))
    assert numbers_of(again) == numbers_of(once)
    assert [len(step.path) for step in again] == [2] * len(once)


def test_limits_may_change(copied, whole):
    further = list(loop(copied, max_nodes=900))
    assert numbers_of(further)[:len(whole) - 1] == whole[:-1] and len(further) > len(whole)
    assert len(list(loop(copied, max_nodes=100))) == len(further)  # what is there stays


@pytest.mark.parametrize("what, options", [
    ("engine", {"engine": am.Bisect(passes=1)}), ("mark", {"mark": am.Doerfler(0.3)}),
    ("indicator", {"indicator": am.Recovery()}), ("solver", {"solver": am.Multigrid()}),
    ("transfer", {"transfer": am.L2()}), ("grids", {"start": 7e-3}), ("law", {"problem": upset(0.4)}),
    ("path", {"load_path": am.LoadPath({}, default=[0.5, 1.0])})])
def test_a_store_of_something_else_is_refused(kept, what, options):
    given = {"problem": upset(), "start": COARSE, "engine": am.Bisect(), "max_nodes": NODES, "store": kept} | options
    with pytest.raises(ValueError, match=f"another loop.*{what}"):
        am.adapt(**given)


class Some:
    """Marks a share of the elements; neither its repr nor its class tells which."""

    def __init__(self, share: object) -> None:
        self.share = share

    def mark(self, estimate: am.Estimate):
        return am.Doerfler(0.5 if isinstance(self.share, np.random.Generator) else self.share).mark(estimate)


def between_nodes(bump: float) -> am.Coulomb:
    """Friction that differs by the bump between the nodes of the first mesh only."""
    return am.Coulomb(lambda x: 0.5 + bump * np.sin(np.pi * x[:, 0] / COARSE) ** 2)


def test_laws_and_parts_of_the_user_are_compared_by_value(tmp_path):
    """A friction of other values between the nodes of the first mesh was answered with 4.12e-5 for 4.18e-5."""
    def run(bump: float = 0.0, share: object = 0.5, **options: object):
        problem = am.cases.upset_block(law=between_nodes(bump))
        return am.adapt(problem, COARSE, mark=Some(share), engine=am.Bisect(), max_nodes=60, store=tmp_path, **options)

    once = list(run())
    assert numbers_of(list(run())) == numbers_of(once)
    with pytest.raises(ValueError, match=r"another loop: .*bump"):
        run(bump=-0.3)
    with pytest.raises(ValueError, match="another loop: value of mark differs"):
        run(share=0.4)
    with pytest.raises(TypeError, match=r"value of mark, which cannot be compared .*depends=\{'mark': \.\.\.\}"):
        run(share=np.random.default_rng(0))
    with pytest.raises(TypeError, match="depends must be a mapping"):
        run(depends=3)


def test_what_cannot_be_compared_is_named_by_depends(tmp_path):
    def run(version: int):
        return am.adapt(upset(), COARSE, mark=Some(np.random.default_rng(0)), engine=am.Bisect(), max_nodes=60,
                        store=tmp_path, depends={"mark": version})

    assert numbers_of(list(run(1))) == numbers_of(list(run(1)))
    with pytest.raises(ValueError, match="another loop: depends mark differs"):
        run(2)


def test_a_damaged_file_is_named_with_what_to_do(copied):
    file = copied / "estimate_0001.npz"
    file.write_bytes(file.read_bytes()[:-10])
    with pytest.raises(ValueError, match=r"step_0001.*remove it"):
        list(loop(copied))
    for old in copied.glob("step_*.json"):
        if old.name >= "step_0001.json":
            old.unlink()
    assert list(loop(copied))[-1].outcome


@pytest.mark.parametrize("text", [b"", b"[]", b"{}", b"\xff", b'{"levels": [], "files": {}}'])
def test_a_step_that_says_nothing_is_damaged(copied, text):
    (copied / "step_0001.json").write_bytes(text)
    with pytest.raises(ValueError, match="damaged"):
        list(loop(copied))


@pytest.mark.parametrize("changes", [
    {"levels": [[0, 3], [1, -1]]}, {"levels": [[1, -1], [0, -1]]}, {"levels": "x"}, {"files": {}}, {"step": 0},
    {"total_seconds": float("nan")}, {"timings": {"solve": "long"}}, {"extra": "0"}, {"key": 3}])
def test_a_step_that_was_changed_is_damaged(copied, changes):
    file = copied / "step_0001.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    with pytest.raises(ValueError, match=r"step_0001\.json is damaged .*remove it"):
        list(loop(copied))


@pytest.mark.parametrize("changes", [{"fingerprint": [1]}, {"fingerprint": None}, {"key": []}, {"more": float("nan")}])
def test_a_head_that_was_changed_is_damaged(copied, changes):
    head = json.loads((copied / "loop.json").read_text())
    (copied / "loop.json").write_text(json.dumps(head | changes))
    with pytest.raises(ValueError, match=r"loop\.json is damaged"):
        loop(copied)


def test_steps_of_another_loop_or_in_another_order_are_refused(kept, copied, tmp_path):
    list(itertools.islice(loop(tmp_path / "other", max_nodes=60, mark=am.Doerfler(0.4)), 1))
    shutil.copy(tmp_path / "other" / "step_0000.json", copied)
    with pytest.raises(ValueError, match=r"step_0000\.json belongs to another loop"):
        list(loop(copied))
    shutil.copy(kept / "step_0001.json", copied / "step_0000.json")
    with pytest.raises(ValueError, match=r"step_0000\.json belongs to another loop or step"):
        list(loop(copied))


def test_a_full_disk_is_said_with_the_file(tmp_path, monkeypatch):
    """The steps before are kept, and the loop goes on when there is room."""
    steps = loop(tmp_path)
    next(steps)

    def full(descriptor: int, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match=r"No space left on device: '.*step_0001\.npz'"):
        patch.setattr("os.write", full)
        next(steps)
    assert [file.name for file in tmp_path.glob("*0001*")] == []
    assert len(list(loop(tmp_path))) > 1


def test_a_missing_step_is_told(copied):
    (copied / "step_0001.json").unlink()
    with pytest.raises(ValueError, match="missing"):
        list(loop(copied))


def test_folders_of_something_else_are_refused(copied, tmp_path):
    head = json.loads((copied / "loop.json").read_text())
    (copied / "loop.json").write_text(json.dumps(head | {"format": 99}))
    with pytest.raises(ValueError, match="another version"):
        loop(copied)
    (copied / "loop.json").unlink()
    with pytest.raises(ValueError, match="something else"):
        loop(copied)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ValueError, match="folder"):
        loop(file)
