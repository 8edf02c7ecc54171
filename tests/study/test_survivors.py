"""What only a deliberate break of the engine brought to light: each of these tests fails for one line changed."""

from __future__ import annotations

import math
import os
import signal
import sqlite3
import time
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from adaptmg.study import Study
from adaptmg.study import kept_files as kept
from adaptmg.study import store as rescue
from adaptmg.study.execute import compute
from adaptmg.study.kept_files import pack
from adaptmg.study.record import Record, canonical
from adaptmg.study.store import Store
from adaptmg.study.study import in_order


def squares(n):
    return {"square": n * n}


def test_a_row_whose_writing_was_interrupted_is_written_in_the_end(tmp_path, monkeypatch):
    study, turns = Study(squares, {"n": range(4)}, tmp_path / "s.sqlite"), iter(range(100))
    check = study._store._check_there

    def interrupted():
        if next(turns) == 2:
            raise KeyboardInterrupt
        check()

    monkeypatch.setattr(study._store, "_check_there", interrupted)
    with pytest.raises(KeyboardInterrupt):
        study.run(progress=False)
    assert [record.parameters["n"] for record in Store(tmp_path / "s.sqlite").get("squares").values()] == [0, 1, 2]


@pytest.mark.parametrize("later", ["mine", "theirs"])
def test_of_two_rows_for_a_point_the_later_stays(tmp_path, later):
    times = {"mine": "2026-01-02T00:00:00", "theirs": "2026-01-01T00:00:00"}
    if later == "theirs":
        times = dict(zip(times, reversed(times.values()), strict=True))
    for name, finished in times.items():
        Store(tmp_path / name).put("s", Record(parameters={"n": 1}, status="done", results={"from": name},
                                               finished=finished))
    mine = Store(tmp_path / "mine")
    assert mine.take_in(tmp_path / "theirs") == (later == "theirs")
    assert [record.results["from"] for record in mine.get("s").values()] == [later]


def test_a_row_survives_a_power_cut(tmp_path):
    """That cannot be tested, but SQLite can be asked whether it waits for the disk (2: FULL)."""
    store = Store(tmp_path / "s.sqlite")
    assert store._connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert store._connection.execute("PRAGMA journal_mode").fetchone() == ("delete",)


@pytest.mark.skipif(os.name != "posix", reason="symbolic links")
def test_a_link_to_a_store_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.sqlite").symlink_to(tmp_path / "real" / "s.sqlite")
    study = Study(lambda n: {"a": np.ones(2)}, {"n": [1]}, tmp_path / "link.sqlite", name="s")
    study.run(progress=False)
    assert sorted(path.name for path in (tmp_path / "real").iterdir()) == ["s.sqlite", "s.sqlite.files"]
    assert (tmp_path / "link.sqlite").is_symlink()


def test_runs_of_which_nothing_is_known_go_first():
    points = [{"n": n} for n in range(4)]
    stored = {canonical({"n": n}): Record(parameters={"n": n}, status="done", seconds=known, results={"cost": known})
              for n, known in ((0, 1.0), (2, 5.0))}
    stored[canonical({"n": 3})] = Record(parameters={"n": 3}, status="done", seconds=math.nan)
    assert [point["n"] for point in in_order(points, "seconds", stored)] == [1, 3, 2, 0]
    assert [point["n"] for point in in_order(points, "cost", stored)] == [1, 3, 2, 0]
    assert [point["n"] for point in in_order(points, "n", stored)] == [3, 2, 1, 0]
    with pytest.raises(TypeError, match="cost must be"):
        in_order(points, 3, stored)
    table = Study(lambda n: {"began": time.monotonic_ns()}, {"n": range(4)}).run(progress=False, cost="n")
    assert table["began"].is_monotonic_decreasing


def test_failed_runs_are_tried_again_unless_one_says_no():
    turns = iter(range(100))

    def run(n):
        raise ValueError(f"turn {next(turns)}")

    study = Study(run, {"n": [1]}, depends={"turns": None})
    errors = [study.run(progress=False, retry_failed=again)["error"][0] for again in (True, False, True)]
    assert errors == ["ValueError: turn 0", "ValueError: turn 0", "ValueError: turn 1"]


def test_files_that_cannot_be_put_beside_the_store_are_safe_elsewhere(tmp_path, monkeypatch):
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    study = Study(lambda n: {"a": np.full(3, n)}, {"n": [1, 2]}, tmp_path / "s.sqlite", name="s")
    (tmp_path / "s.sqlite.files").write_text("in the way", encoding="utf-8")
    with pytest.raises(OSError, match=r"s\.sqlite\.files: .*in the way.*safe in (\S+): copy") as error:
        study.run(progress=False)
    assert study.table()["status"].tolist() == ["done", "missing"]
    (tmp_path / "s.sqlite.files").unlink()
    (rescued,) = (tmp_path / "temporary").glob("s.sqlite.files.rescued-*")
    assert str(rescued) in str(error.value)
    rescued.rename(tmp_path / "s.sqlite.files")
    assert study.run(progress=False)["status"].tolist() == ["done", "done"]
    assert [study.load(k, "a")[0] for k in (0, 1)] == [1, 2]


def test_a_masked_array_is_not_kept_without_its_mask():
    table = Study(lambda n: {"a": np.ma.array([1, 2], mask=[False, True])}, {"n": [1]}).run(progress=False)
    assert "mask would be lost" in table["error"][0]


def test_a_file_that_another_changes_while_runs_go_on_is_not_what_they_left_behind(tmp_path):
    file = tmp_path / "data.txt"
    file.write_text("1", encoding="utf-8")

    def run(n):
        value = int(file.read_text(encoding="utf-8"))
        file.write_text("2", encoding="utf-8")
        return {"m": value}

    study = Study(run, {"n": [1]}, depends={"data": file, "file": None})
    assert study.run(progress=False)["m"][0] == 1 and study.table()["status"][0] == "stale"
    assert study.run(progress=False)["m"][0] == 2 and study.table()["status"][0] == "done"


def test_versions_are_told_as_reasons_and_failures_are_counted(monkeypatch, capsys, caplog):
    from adaptmg.study import study as module

    def run(n):
        return {"m": 1 / n}

    study = Study(run, {"n": [0, 1, 2]})
    caplog.set_level("INFO", logger="adaptmg.study")
    study.run(progress=False)
    assert "study run: [1/3] n=0 failed: ZeroDivisionError" in caplog.text
    assert "[2/3] n=1 done" in caplog.text and "1 failed, 1 running, 1 left, ends about" in caplog.text
    assert "1 failed, the end" in caplog.text
    study.run(progress=True)
    assert "1 failed" in capsys.readouterr().err
    now = module.environment()
    monkeypatch.setattr(module, "environment", lambda: now | {"numpy": "0.1", "new": "3"})
    assert study.status().reasons == {f"numpy {now['numpy']} -> 0.1": 3, "new none -> 3": 3}
    assert "stale: new none -> 3 (3)" in repr(study.status())


def test_what_is_kept_is_the_same_file_each_time():
    def drawn():
        figure = Figure()
        figure.subplots().plot([1, 2], [3, 4], "o")
        return pack(figure)

    assert drawn() == drawn() and b"clip-path" in drawn().content


def test_kept_files_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    def dies(target, content):
        raise KeyboardInterrupt

    monkeypatch.setattr(kept, "write_bytes", dies)
    folder = kept.Folder(tmp_path / "s.sqlite")
    with pytest.raises(KeyboardInterrupt):
        folder.write("s", "{}", {"a": kept.Packed(".txt", b"x")})
    assert not [path for path in folder.path.rglob("*") if path.is_file()]


@pytest.mark.skipif(os.name != "posix", reason="symbolic links and pipes")
@pytest.mark.parametrize("kind", ["..", "absolute", "link", "linked folder", "pipe"])
def test_what_a_row_from_elsewhere_names_is_neither_read_nor_removed(tmp_path, kind):
    secret, folder = tmp_path / "secret.txt", tmp_path / "s.sqlite.files"
    secret.write_text("x", encoding="utf-8")
    folder.mkdir()
    (folder / "link.txt").symlink_to(secret)
    (folder / "linked").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe.txt")
    path = {"..": "../secret.txt", "absolute": str(secret), "link": "link.txt", "linked folder": "linked/secret.txt",
            "pipe": "pipe.txt"}[kind]
    study = Study(squares, {"n": [1]}, tmp_path / "s.sqlite")
    study._store.put("squares", Record(parameters={"n": 1}, status="done", files={"a": path}))
    with pytest.raises(ValueError, match="is no file of this store"):
        study.load(0)
    assert study.run(progress=False)["status"].tolist() == ["done"]
    assert secret.exists() and (folder / "link.txt").is_symlink() and (folder / "pipe.txt").exists()


def test_rows_are_safe_in_the_next_folder_where_the_first_cannot_be_written(tmp_path, monkeypatch):
    write, elsewhere = rescue._write, tmp_path / "temporary"

    def full(target, *rest):
        if target.parent == tmp_path:
            raise OSError("full")
        write(target, *rest)

    monkeypatch.setattr(rescue, "_write", full)
    monkeypatch.setattr(rescue.tempfile, "gettempdir", lambda: str(elsewhere))
    assert f"safe in {elsewhere}" in rescue.save(tmp_path / "s.sqlite", None, [])
    monkeypatch.setattr(rescue, "_write", lambda target, *rest: (_ for _ in ()).throw(OSError("full")))
    assert "could not be written elsewhere either" in rescue.save(tmp_path / "s.sqlite", None, [])


def test_rows_that_adaptmg_cannot_have_written_are_told(tmp_path):
    store = Store(tmp_path / "s.sqlite")
    store.put("s", Record(parameters={"n": 1}, status="failed", error="\udcff\x00", machine="\udcff"))
    assert store.get("s")[canonical({"n": 1})].error
    for column, value in (("seconds", "long"), ("finished", b"x"), ("peak_memory", "x"), ("files", '{"a": 1}')):
        with store._connection as connection:
            (before,) = connection.execute(f"SELECT {column} FROM runs").fetchone()
            connection.execute(f"UPDATE runs SET {column} = ?", (value,))
        with pytest.raises(ValueError, match="is damaged: the run"):
            store.get("s")
        with store._connection as connection:
            connection.execute(f"UPDATE runs SET {column} = ?", (before,))
    assert len(store.get("s")) == 1


def test_limits_are_refused_where_nobody_starts_a_worker_again():
    pytest.importorskip("distributed")

    from adaptmg.study.cluster import check_workers

    workers = {"tcp://w": {"nthreads": 1, "nanny": None}}
    client = SimpleNamespace(scheduler=SimpleNamespace(address="tcp://s"), wait_for_workers=lambda n, timeout: None,
                             scheduler_info=lambda n_workers: {"workers": workers}, run=lambda *a, **k: {})
    for limits in ({"limit_s": 1.0, "memory_limit": None}, {"limit_s": None, "memory_limit": 10**9}):
        with pytest.raises(ValueError, match="has no nanny"):
            check_workers(client, SimpleNamespace(**limits), {})


def test_a_worker_that_leaves_while_it_is_looked_at_is_no_unfit_one(caplog):
    pytest.importorskip("distributed")

    from distributed.comm import CommClosedError

    from adaptmg.study.cluster import check_workers
    from adaptmg.study.in_worker import Order

    found = {"tcp://w": CommClosedError("reset by peer"), "tcp://v": ""}
    client = SimpleNamespace(scheduler=SimpleNamespace(address="tcp://s"), wait_for_workers=lambda n, timeout: None,
                             scheduler_info=lambda n_workers: {"workers": {}}, run=lambda *a, **k: found)
    order = Order(b"", "", "", (), False, None, None)
    check_workers(client, order, {})
    assert "the worker tcp://w left while it was looked at" in caplog.text
    found["tcp://v"] = OSError("no such file")
    with pytest.raises(RuntimeError, match="tcp://v cannot compute this study: OSError: no such file"):
        check_workers(client, order, {})


def test_no_more_processes_are_started_than_there_are_runs(monkeypatch):
    pytest.importorskip("distributed")
    from contextlib import contextmanager

    from adaptmg.study import cluster as executor

    asked = []

    @contextmanager
    def pretended(workers):
        asked.append(workers)
        yield None

    monkeypatch.setattr(executor, "local_cluster", pretended)
    for workers, runs in ((64, 3), (2, 100), (4, 0)):
        with executor.opened(workers, None, runs):
            pass
    assert asked == [3, 2, 1]


class _Processes:
    """Stands for dask's cluster: ends while it starts as often as it is said, or hears Ctrl-C meanwhile."""

    def __init__(self, fails=0, signals=False):
        self.fails, self.signals, self.workers, self.closed = fails, signals, {}, []

    def __call__(self, **options):
        if self.signals:
            signal.raise_signal(signal.SIGINT)
        self.fails -= 1
        if self.fails >= 0:
            raise RuntimeError("Nanny failed to start.")
        return self

    def close(self, timeout=None):
        self.closed.append(timeout)


@pytest.mark.parametrize("fails", [2, 3])
def test_processes_that_end_while_they_start_are_started_again(fails, monkeypatch):
    local = pytest.importorskip("adaptmg.study.cluster")
    processes = _Processes(fails)
    monkeypatch.setattr(local, "LocalCluster", processes)
    monkeypatch.setattr(local, "Client", lambda *_, **__: SimpleNamespace(close=lambda timeout: None))
    if fails < 3:
        with local.local_cluster(2):
            assert not processes.closed
        assert processes.closed
    else:
        with pytest.raises(OSError, match=r"workers: 2 processes could not be started.*fewer workers"), \
                local.local_cluster(2):
            pass


@pytest.mark.parametrize("fails", [0, 1])
def test_ctrl_c_while_processes_start_ends_them(fails, monkeypatch):
    local = pytest.importorskip("adaptmg.study.cluster")
    processes, heard = _Processes(fails, signals=True), signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(local, "LocalCluster", processes)
    monkeypatch.setattr(local, "Client", lambda *_, **__: SimpleNamespace(close=lambda timeout: None))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in a shell's background it comes ignored
    try:
        with pytest.raises(KeyboardInterrupt), local.local_cluster(2):
            pytest.fail("the block is not reached")
    finally:
        signal.signal(signal.SIGINT, heard)
    assert bool(processes.closed) == (fails == 0)


def test_runs_are_sent_ahead_only_while_no_worker_has_died_and_they_are_short():
    executor = pytest.importorskip("adaptmg.study.cluster")
    runs = object.__new__(executor._Runs)
    runs._died, runs._allowed, runs._recent = False, 0, executor.deque([1e-3] * 8, maxlen=8)
    assert runs._far_ahead() == 10
    runs._recent.append(0.1)
    assert runs._far_ahead() == 2
    for died, allowed in ((True, 0), (False, 3)):
        runs._died, runs._allowed = died, allowed
        assert runs._far_ahead() == 1


@pytest.mark.parametrize(("since", "told"), [(3.2, None), (4.8, "TimeLimit: stopped after limit_s=3 s")])
def test_a_death_that_is_told_of_late_is_no_time_limit(since, told, monkeypatch):
    """Code that holds Python's lock is ended two seconds after its limit, without a word."""
    executor = pytest.importorskip("adaptmg.study.cluster")
    runs = object.__new__(executor._Runs)
    runs._limit_s, runs._over, runs._left, runs._alone = 3.0, {}, executor.deque(), executor.deque()
    now = 100.0
    monkeypatch.setattr(executor, "time", SimpleNamespace(monotonic=lambda: now))
    run = executor._Run({"n": 6}, 1, now - since, None, False, now - since)
    runs._out = {"run": run}
    found = runs._outcome("run", executor.KilledWorker("run", None, 0))
    assert found is None if told is None else found[1].error == told
    assert list(runs._left) == ([({"n": 6}, 2)] if told is None else [])


@pytest.mark.parametrize("local", [True, False])
def test_a_study_does_not_wait_for_ever_for_processes_of_this_machine(local, monkeypatch, caplog):
    executor = pytest.importorskip("adaptmg.study.cluster")

    monkeypatch.setattr(executor, "_PATIENCE_S", 0.02)
    monkeypatch.setattr(executor, "_LOOK_S", 0.01)
    started = []
    monkeypatch.setattr("adaptmg.study.cluster.revive", started.append)
    told = iter(range(20))

    def looked(turn):
        if turn == 8:
            runs._back.put(("run", None))
        return {"w": 1} if turn == 2 else {}

    runs = object.__new__(executor._Runs)
    runs._back, runs._out, runs._left, runs._alone = executor.queue.SimpleQueue(), {}, [], []
    from distributed.core import Status

    processes = object.__new__(executor.LocalCluster)
    processes.worker_spec, processes.status = {0: None}, Status.closed  # it cannot be closed
    runs._client = SimpleNamespace(cluster=processes if local else None, scheduler=SimpleNamespace(address="tcp://s"),
                                   nthreads=lambda: looked(next(told)))
    if local:
        with pytest.raises(OSError, match="does not start them again"):
            runs._come_back()
        assert next(told) == 6  # three times in turn
        assert started == [processes] * 4  # twice before the worker of turn 2, and twice after
    else:
        assert runs._come_back() == [("run", None)] and not started
    assert "has no workers: 0 runs wait" in caplog.text


def test_a_function_that_carries_too_much_is_refused():
    sending = pytest.importorskip("adaptmg.study.in_worker")
    large = np.ones(sending._MOST // 8 + 1)
    with pytest.raises(TypeError, match=r"carries 52 MB of values"):
        sending.sent(lambda n: {"m": large[n]})


async def coroutine(n):
    return {"m": n}


def generator(n):
    yield {"m": n}


@pytest.mark.parametrize("function", [coroutine, generator])
def test_coroutines_and_generators_are_refused_before_they_run(function):
    with pytest.raises(TypeError, match=f"{function.__name__} is a generator or a coroutine"):
        Study(function, {"n": [1]})


class OddBaseError(BaseException):
    def __str__(self):
        raise GeneratorExit


@pytest.mark.parametrize("error", [SystemExit(3), GeneratorExit(), OddBaseError(), KeyboardInterrupt()])
def test_whatever_a_run_raises_is_its_failure(error):
    def run(n):
        raise error

    found = compute(run, {"n": 1}, interruptible=False)
    assert found.error.startswith(f"{type(error).__name__}: ") and found.exception is error
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            compute(run, {"n": 1})
    else:
        table = Study(run, {"n": [1, 2]}, depends={"error": None}).run(progress=False)
        assert table["status"].tolist() == ["failed", "failed"]


def test_a_store_beside_which_another_program_keeps_its_version_is_told_apart(tmp_path):
    with sqlite3.connect(tmp_path / "s.sqlite") as other:
        other.execute("CREATE TABLE runs (a, b)")
        other.execute("PRAGMA user_version = 2")
    other.close()
    with pytest.raises(ValueError, match="not a store of adaptmg"):
        Store(tmp_path / "s.sqlite")
