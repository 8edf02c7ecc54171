"""Refusals as a table."""

import pytest


def check_refused(*rows):
    """Call what each ``(call, message)`` calls: a ValueError must say the message."""
    for call, message in rows:
        with pytest.raises(ValueError, match=message):
            call()


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
