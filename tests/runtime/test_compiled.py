"""Kernels without a way in from Python, and values that are remembered as long as their object lives."""

import gc
import pickle
import weakref

import numpy as np
import pytest

from adaptmg._runtime import inner_kernel, kernel, remembered


@inner_kernel(cache=False, fastmath=True)
def _twice(value):
    return 2.0 * value


@kernel(cache=False)
def _both(values):
    for k in range(len(values)):
        values[k] = _twice(values[k])


def test_a_call_of_an_inner_kernel_from_python_is_an_error_that_names_it():
    values = np.ones(3)
    for compiled in (False, True):
        for inner in (_twice, pickle.loads(pickle.dumps(_twice))):
            with pytest.raises(TypeError, match=rf"{_twice.__module__}\._twice is called by compiled code alone"):
                inner(1.0)
        assert bool(_twice.signatures) is compiled  # with its caller
        _both(values)
    np.testing.assert_array_equal(values, 4.0)


@inner_kernel(cache=False)
def _first(numbers, turned):
    return numbers[1] if turned else numbers[0]


def test_an_inner_kernel_is_compiled_once_for_numbers_in_the_text_and_in_variables():
    @kernel(cache=False)
    def all_of_them(a, b, turned):
        return _first((a, b), turned) + _first((2, 3), False) + _first(numbers=(4, 5), turned=True)

    assert all_of_them(10, 20, True) == 20 + 2 + 5
    assert len(_first.signatures) == 1


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
