"""Kernels without a way in from Python, and values that are remembered as long as their object lives."""

from __future__ import annotations

import gc
import pickle
import weakref

import numpy as np
import pytest

from adaptmg._runtime import inner_kernel, kernel, remembered


@inner_kernel(cache=False)
def _twice(value):
    return 2.0 * value


@inner_kernel(cache=False, fastmath=True)
def _thrice(value):
    return 3.0 * value


@kernel(cache=False)
def _both(values):
    for k in range(len(values)):
        values[k] = _twice(values[k]) + _thrice(values[k])


@pytest.mark.parametrize("inner", [_twice, _thrice])
def test_a_call_of_an_inner_kernel_from_python_is_an_error_that_names_it(inner):
    message = rf"{inner.py_func.__module__}\.{inner.py_func.__name__} is called by compiled code alone"
    with pytest.raises(TypeError, match=message):
        inner(1.0)
    values = np.ones(3)
    _both(values)
    np.testing.assert_array_equal(values, 5.0)
    assert inner.signatures, "compiled with its caller"
    with pytest.raises(TypeError, match=message):
        inner(1.0)
    assert inner.py_func(1.0) in (2.0, 3.0)


def test_inner_kernels_come_back_from_pickles_as_what_they_are():
    found = pickle.loads(pickle.dumps(_twice))
    with pytest.raises(TypeError, match="compiled code alone"):
        found(1.0)


def test_a_division_by_zero_is_as_in_numpy():
    @kernel(cache=False)
    def over(a, b):
        return a / b

    assert over(1.0, 0.0) == np.inf


class Thing:
    pass


def test_a_value_is_computed_once_an_object_and_does_not_keep_it_alive():
    calls = []
    function = remembered(lambda thing: calls.append(id(thing)))
    one, other = Thing(), Thing()
    assert [function(one), function(one), function(other)] == [None] * 3
    assert calls == [id(one), id(other)]
    gone = weakref.ref(one)
    del one
    gc.collect()
    assert gone() is None


def test_exceptions_are_not_remembered():
    calls = []

    @remembered
    def fails(thing):
        calls.append(thing)
        raise ValueError("no")

    thing = Thing()
    for _ in range(2):
        with pytest.raises(ValueError, match="no"):
            fails(thing)
    assert len(calls) == 2
