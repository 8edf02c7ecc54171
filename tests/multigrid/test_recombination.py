"""What a recombination may cut, and how many cycles a nested start takes between bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid import truncated_contact as contact_kernels
from adaptmg.multigrid.split_matrix import split
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.system import BACKWARDS, CLOSED, SLIPS


@pytest.mark.parametrize("count", [contact_kernels.count_cut, contact_kernels.count_cut.py_func], ids=["jit", "python"])
@pytest.mark.parametrize("alpha, cut", [(0.0, 0), (0.4, 0), (0.6, 1), (1.1, 2), (-1.0, 1)])
def test_nodes_that_a_recombination_would_cut(count, alpha, cut):
    # node 0 is open, 2 from the gap, and closes above alpha = 0.9; node 1 slips by 0.5 and turns above 0.5; the closed
    # node 2 slips by -0.1 and turns below -0.1
    nodes, n = np.arange(3, dtype=np.int32), 3
    frames = np.tile(np.eye(2).reshape(-1), n)
    u = np.array([-2.0, 0.0, 0.0, 0.5, 0.0, -0.1])
    first = u + np.array([2.0 / 0.9, 0.0, 0.0, -1.0, 5.0, -1.0])
    codes = np.array([0, CLOSED + SLIPS, CLOSED + BACKWARDS], dtype=np.int8)
    found = count(2, codes, nodes, frames, np.zeros(n), np.zeros(n), u.copy(), first, u, alpha, 0.0, u)
    assert found == cut


def test_one_node_is_cut_and_many_are_not():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Frictionless()), (4, 8))
    problem = grids.finest.discrete
    problem = replace(problem, contact=replace(problem.contact, gaps=np.ones(len(problem.contact))))
    contact = TruncatedContact.of(problem, split(problem.matrix, problem.fixed))
    contact.codes[:] = 0
    u = np.zeros(problem.n_dofs)
    for moved, admitted in ((0, True), (1, True), (2, False), (9, False)):
        other = u.copy()
        other[2 * problem.contact.nodes[:moved] + 1] = -2.0
        assert contact.admits(u, other, u, (1.0, 0.0)) is admitted


def test_cycles_of_a_nested_start():
    one, finer = (am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8))[k].discrete for k in (0, 1))
    joint = am.Hierarchy.graded(am.cases.dovetail(), (12e-3, 9e-3, 4e-3), 1.0)
    coarse, middle, fine = (level.discrete for level in joint.levels)
    start = am.NestedStart()
    assert start.cycles_on(one, finer) == 1
    assert middle.n_nodes < 3 * coarse.n_nodes and start.cycles_on(coarse, middle) == 1
    assert fine.n_nodes > 3 * middle.n_nodes and start.cycles_on(middle, fine) == 2
    assert am.NestedStart(cycles=3).cycles_on(middle, fine) == 3
