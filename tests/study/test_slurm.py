"""Workers that a queue starts: the example of the guide with dask-jobqueue, on a SLURM that is
none."""

import contextlib
import os
import signal
import time

import pytest

import adaptmg as am

pytest.importorskip("dask_jobqueue")


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    from fake_slurm import fake_slurm

    file = fake_slurm(tmp_path, wait_s=0.8)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    yield lambda: [int(line) for line in file.read_text(encoding="utf-8").splitlines()]
    for job in file.read_text(encoding="utf-8").splitlines():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(job), signal.SIGKILL)


def test_jobs_that_wait_and_one_that_is_cancelled(jobs, tmp_path, monkeypatch, caplog):
    from dask.distributed import Client
    from dask_jobqueue import SLURMCluster

    from adaptmg.study import cluster as executor

    monkeypatch.setattr(executor, "PATIENCE_S", 0.3)

    def run(n):
        if n == 1:
            time.sleep(60)
        time.sleep(0.2)
        return {"m": n * n, "job": os.getpgid(0)}

    with SLURMCluster(
        cores=1,
        processes=1,
        memory="2GB",
        walltime="00:10:00",
        interface="lo",
        log_directory=str(tmp_path),
    ) as cluster:
        cluster.scale(jobs=2)
        with Client(cluster, set_as_default=False) as client:
            study = am.Study(run, {"n": range(6)}, tmp_path / "s.sqlite")
            table = study.run(progress=False, scheduler=client, limit_s=2.5)
            assert "no workers yet: 2 were requested" in caplog.text
            assert table["status"].tolist() == ["done", "failed", *["done"] * 4]
            assert table["error"][1].startswith("TimeLimit") and set(table["job"].dropna()) <= set(
                jobs()
            )
            os.killpg(jobs()[0], signal.SIGTERM)
            end = time.monotonic() + 120
            while len(client.nthreads()) > 1 and time.monotonic() < end:
                time.sleep(0.1)
            again = am.Study(lambda n: {"job": os.getpgid(0)}, {"n": range(4)}).run(
                progress=False, scheduler=client
            )
            assert set(again["job"]) <= set(jobs()[1:])
