"""Results do not depend on BLAS threads, on random numbers, on the run, nor on what another thread
solves."""

import hashlib
import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import threadpoolctl
from bodies import bar_hierarchy, bar_on_block

import adaptmg as am
from adaptmg._threads import one_blas_thread, seeded

AMG_STEPS = am.ActiveSet(linear=am.AMG(), rtol=1e-8)


def outcome(grids, solver):
    result = am.solve(grids, solver, throw=False)
    arrays = (
        grids.finest.discrete.matrix.data,
        result.displacement,
        result.contact.force,
        result.reaction,
        np.array([result.residual, result.error_estimate, result.certificate().energy_error]),
    )
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    ).hexdigest()[:16]


uniform = partial(am.Hierarchy.uniform, am.cases.greco_bar(), (8, 16, 32))
graded = partial(am.Hierarchy.graded, am.cases.greco_bar(), (10e-3, 5e-3))
two_bodies = partial(bar_hierarchy, bar_on_block(am.Coulomb(0.3)), 2)
block = partial(am.Hierarchy.uniform, am.cases.greco_block(), (2, 4, 8))
CASES = {
    "nested start": (uniform, am.FullMultigrid()),
    "graded": (graded, am.FullMultigrid()),
    "graded, monotone": (graded, am.FullMultigrid(correction=am.Monotone(), rtol=1e-4)),
    "L2": (lambda: graded(transfer=am.L2()), am.Multigrid()),
    "active set": (graded, am.ActiveSet()),
    "active set, pyamg": (uniform, AMG_STEPS),
    "two bodies": (two_bodies, am.FullMultigrid()),
    "two bodies, active set": (two_bodies, am.ActiveSet()),
    "3D": (block, am.FullMultigrid()),
    "3D, active set": (block, am.ActiveSet()),
    "aggregation": (
        lambda: am.Hierarchy.algebraic(uniform().finest.discrete),
        am.Multigrid(rtol=1e-5),
    ),
}


@cache
def alone(name):
    make, solver = CASES[name]
    return outcome(make(), solver)


def blas_threads():
    return [
        info["num_threads"]
        for info in threadpoolctl.threadpool_info()
        if info["user_api"] == "blas"
    ]


def test_bits_do_not_depend_on_the_run_or_on_blas_threads():
    threads = "2" if set(blas_threads()) == {1} else "1"
    environment = os.environ | {
        "OPENBLAS_NUM_THREADS": threads,
        "OMP_NUM_THREADS": threads,
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    child = subprocess.run(
        [sys.executable, __file__], env=environment, stdout=subprocess.PIPE, check=True
    )
    assert json.loads(child.stdout) == {name: alone(name) for name in CASES}


def test_threads_at_the_same_time_solve_as_one_after_the_other():
    names = ["active set, pyamg", "two bodies", "aggregation", "3D", "active set, pyamg", "graded"]
    grids = [CASES[name][0]() for name in names]
    found, start = [None] * len(names), threading.Barrier(2)

    def work(first):
        start.wait()
        for k in range(first, len(names), 2):
            found[k] = outcome(grids[k], CASES[names[k]][1])

    workers = [threading.Thread(target=work, args=(first,)) for first in (0, 1)]
    for act in (threading.Thread.start, lambda worker: worker.join(timeout=120)):
        for worker in workers:
            act(worker)
    assert found == [alone(name) for name in names]


def test_the_global_random_numbers_are_left_alone():
    np.random.seed(11)  # noqa: NPY002
    expected = np.random.rand(3)  # noqa: NPY002
    np.random.seed(11)  # noqa: NPY002
    am.solve(uniform(), AMG_STEPS)
    am.Hierarchy.algebraic(uniform().finest.discrete)
    with pytest.raises(KeyError), seeded():
        np.random.rand(1000)  # noqa: NPY002
        raise KeyError
    assert np.array_equal(np.random.rand(3), expected)  # noqa: NPY002


@pytest.fixture
def two_threads():
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        if set(blas_threads()) != {2}:
            pytest.skip("BLAS without threads")
        yield


@pytest.mark.usefixtures("two_threads")
def test_one_blas_thread_inside_and_as_many_as_before_after_it():
    with one_blas_thread():
        with one_blas_thread():
            pass
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}
    with pytest.raises(ValueError, match="gone"), one_blas_thread():
        raise ValueError("gone")
    assert set(blas_threads()) == {2}

    @one_blas_thread()
    def threads(k):
        return blas_threads() if k == 0 else threads(k - 1)

    assert set(threads(2)) == {1} and set(blas_threads()) == {2}


@pytest.mark.usefixtures("two_threads")
def test_the_last_thread_to_leave_gives_it_back():
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10)

    worker = threading.Thread(target=other)
    with one_blas_thread():
        worker.start()
        assert inside.wait(10)
    assert set(blas_threads()) == {1}
    leave.set()
    worker.join()
    assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two_threads")
def test_user_defined_parts_see_one_thread():
    seen = []

    class Asks(am.Interpolation):
        def run(self, hierarchy, run, start):
            seen.extend(blas_threads())
            return am.ActiveSet().run(hierarchy, run, start)

        def build(self, coarse, fine):
            seen.extend(blas_threads())
            return super().build(coarse, fine)

    def limit(points):
        seen.extend(blas_threads())
        return np.full(len(points), 1e7)

    am.solve(uniform(), Asks())
    am.solve_path(uniform(), am.LoadPath(default=[1.0]), Asks())
    graded(transfer=Asks())
    problem = replace(am.cases.greco_bar(), law=am.Tresca(limit), reference={})
    am.discretise(problem, am.mesh.structured(problem.domain, 4))
    uniform().with_problem(problem)
    assert len(seen) >= 5 * len(blas_threads()) and set(seen) == {1}


def test_a_fork_inside_is_free_again():
    code = (
        "import os, threadpoolctl\nfrom adaptmg._threads import one_blas_thread\nimport scipy.linalg\n"
        "with one_blas_thread():\n    child = os.fork()\n    if child == 0:\n"
        "        with one_blas_thread():\n            pass\n        os._exit(0)\n"
        "assert os.waitpid(child, 0)[1] == 0\n"
    )
    done = subprocess.run([sys.executable, "-c", code], timeout=60, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


if __name__ == "__main__":
    sys.stdout.write(json.dumps({name: alone(name) for name in CASES}))
