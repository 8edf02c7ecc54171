"""Refusals as a table."""

import pytest


def refused(*rows):
    """Return a test that each ``(call, message)`` raises a ValueError; another error stands between
    the two."""

    @pytest.mark.parametrize(
        ("call", "error", "message"),
        [(row[0], (ValueError, *row[1:-1])[-1], row[-1]) for row in rows],
    )
    def test(call, error, message):
        with pytest.raises(error, match=message):
            call()

    return test
