"""Cells of a report's tables: digits alike, words for identifiers."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from adaptmg.export.report import columns_of, worded


def column(values, spec=""):
    """The only column of a table."""
    return columns_of(pd.DataFrame({"x": values}), None, {"x": spec} if spec else None)[0]


@pytest.mark.parametrize(("values", "shown"), [
    ([0.0534, 0.015004, 12.0], ["0.05340", "0.01500", "12.00"]),
    ([0.1, 0.25, 1.0], ["0.1", "0.25", "1"]),  # chosen, not measured
    ([1.0, 2.0, np.nan], ["1", "2", "-"]), ([1, 2, 30], ["1", "2", "30"]),
    ([1234.56, 7.0], ["1235", "7.000"]), ([0.1, np.inf, 1 / 3], ["0.1000", "inf", "0.3333"]),
    (["1.50", "b"], ["1.50", "b"])])
def test_measured_numbers_keep_their_zeros_and_chosen_ones_none(values, shown):
    assert column(values).texts == shown


def test_given_formats_are_kept():
    assert column([1.26, 2.0], spec=".1f").texts == ["1.3", "2.0"]
    assert column([0.123456, 2.0], spec=".2g").texts == ["0.12", "2.0"]
    assert column([3.2e-15, 0.0], spec=".1e").texts == ["3.2e-15", "0"]
    assert column(pd.array([1.26, None], "Float64"), spec=".2g").texts == ["1.3", "-"]


def test_identifiers_become_words_and_their_unit():
    assert worded("total_s") == ("total", "s") and worded("mesh_ratio") == ("mesh ratio", "")
    assert worded("total_s", "ms") == ("total s", "ms")
    assert worded("u_n") == ("u_n", "") and worded("a b") == ("a b", "")
