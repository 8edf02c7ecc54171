"""Whether workers can compute a study, told at once; and functions that run on workers which may lack adaptmg."""

from __future__ import annotations

import functools
import itertools
import logging
import pickle
from collections.abc import Callable
from typing import Any

from distributed import Client, LocalCluster
from distributed.comm import CommClosedError

from adaptmg.study.cluster.in_worker import Order
from adaptmg.study.cluster.local import revive
from adaptmg.study.execute import error_text

__all__ = ["check_workers", "on_any_worker", "start_again"]

_log = logging.getLogger(__name__)

#: how long a cluster may take to have a worker
PATIENCE_S = 60.0
#: how often it is looked for before processes of this machine are given up
_TRIES = 3


def check_workers(client: Client, order: Order, parts: dict[str, str]) -> None:
    """Tell of workers that could not compute the runs, or would compute others; ``parts`` are those of the fingerprint.

    Raises
    ------
    OSError
        If there are no workers.
    ValueError
        If they are started wrongly.
    RuntimeError
        If one has another adaptmg or other packages, or lacks a module.
    """
    address = client.scheduler.address
    _wait_for_one(client, address)
    for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        if worker["nthreads"] != 1:
            raise ValueError(f"the worker {name} has {worker['nthreads']} threads: start workers with one each ('dask "
                             f"worker {address} --nthreads 1 --nworkers N'), as libraries below are not safe for more")
        if not worker["nanny"] and (order.limit_s is not None or order.memory_limit is not None):
            raise ValueError(f"the worker {name} has no nanny, which would start it again after limit_s or "
                             "memory_limit ended it: start workers without --no-nanny")
    for name, found in client.run(_fitness(pickle.dumps((order, parts))), on_error="return").items():
        told = found if isinstance(found, str) else error_text(found)
        if isinstance(found, CommClosedError):
            _log.warning("the worker %s left while it was looked at", name)
        elif told:
            raise RuntimeError(f"the worker {name} cannot compute this study: {told}")


def _wait_for_one(client: Client, address: str) -> None:
    """Until there is a worker: as long as it takes where jobs were submitted, which may wait in a queue for hours."""
    for tries in itertools.count(1):
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            if isinstance(client.cluster, LocalCluster):
                start_again(client.cluster, tries)
            elif not getattr(client.cluster, "worker_spec", None):
                raise OSError(f"the scheduler {address} has no workers after {PATIENCE_S:g} s: start some with 'dask "
                              f"worker {address} --nthreads 1', or, where they come later, wait for the first "
                              "(client.wait_for_workers(1)); a cluster that adapts needs a minimum of them") from None
            else:
                _log.warning("the scheduler %s has no workers yet: %d were asked for", address,
                             len(client.cluster.worker_spec))
        else:
            return


def start_again(cluster: LocalCluster, tries: int) -> None:
    """Start processes of this machine anew, of which none is left; OSError after some tries."""
    if tries == _TRIES:
        raise OSError("the processes that compute runs ended, and the system does not start them again (is it out of "
                      "memory, or very busy?); what is done is stored: run the study again, with fewer workers")
    _log.warning("no process that computes runs is left: starting %d", len(cluster.worker_spec))
    revive(cluster)


def _fitness(order: bytes) -> Callable[[], str]:
    """A check as a function inside a function, which is sent by value: the worker may not have this module."""
    def check(order: bytes) -> str:
        import pickle

        try:
            from adaptmg.study.cluster.in_worker import UnfitWorker, readied

            unpacked, parts = pickle.loads(order)
        except Exception as error:
            return f"it lacks adaptmg, or has another version ({type(error).__name__}: {error})"
        try:
            readied(unpacked, parts)
        except UnfitWorker as error:
            return str(error)
        return ""

    return functools.partial(check, order)


def on_any_worker() -> Callable[..., Any]:
    """What computes one run on a worker, by value too: a worker that joins later may not have this module."""
    def perform(order: bytes, point: dict[str, Any], tries: int, name: str, topic: str) -> Any:
        import pickle

        from distributed import get_worker

        try:
            from adaptmg.study.cluster import in_worker

            unpacked = pickle.loads(order)
        except Exception as error:
            class UnfitWorker(RuntimeError):
                pass

            raise UnfitWorker(f"it lacks adaptmg, or has another version ({type(error).__name__}: {error})") from None
        worker = get_worker()
        return in_worker.perform(unpacked, point, tries,
                                 lambda why: worker.log_event(topic, {"run": name, "why": why}))

    return perform
