"""remembered: once an object, as long as it lives; exceptions are raised each time."""

from __future__ import annotations

import gc
import weakref

import pytest

from adaptmg._runtime import remembered


class Thing:
    pass


def test_it_computes_once_an_object():
    calls = []
    function = remembered(lambda thing: calls.append(thing))
    one, other = Thing(), Thing()
    assert [function(one), function(one), function(other)] == [None] * 3
    assert calls == [one, other]


def test_an_object_is_not_kept_alive():
    function = remembered(id)
    thing = Thing()
    function(thing)
    gone = weakref.ref(thing)
    del thing
    gc.collect()
    assert gone() is None


def test_exceptions_are_raised_each_time():
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
