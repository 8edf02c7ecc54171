"""The codes that the solvers keep of contact nodes, and the states that results hold."""

import numpy as np

import adaptmg as am
from adaptmg.smoother.system import BACKWARDS, CLOSED, FREE, HELD, SLIPS, contact_codes, contact_states


def test_codes_of_flags():
    closed, held = np.array([0, 0, 1, 1, 1], dtype=bool), np.array([0, 1, 0, 1, 0], dtype=bool)
    backwards = np.array([0, 1, 0, 1, 1], dtype=bool)
    assert contact_codes(closed, held, backwards).tolist() == [
        SLIPS, HELD, CLOSED + SLIPS, CLOSED + HELD, CLOSED + BACKWARDS]
    assert contact_codes(closed, held).tolist() == [SLIPS, HELD, CLOSED + SLIPS, CLOSED + HELD, CLOSED + SLIPS]


def test_states_of_codes():
    codes = np.array([FREE, HELD, CLOSED + FREE, CLOSED + SLIPS, CLOSED + BACKWARDS, CLOSED + HELD, CLOSED + HELD])
    force = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    found = contact_states(codes, force)
    assert found.dtype == np.int8
    assert found.tolist() == [am.OPEN, am.OPEN, am.SLIP, am.SLIP, am.SLIP, am.STICK, am.OPEN]
