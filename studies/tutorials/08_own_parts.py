"""
Your own transfer, smoother and indicator
=========================================

A part is an object with the right method; :doc:`/howto/own_parts` lists them.
"""

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

import adaptmg as am


class ThreeNearest:  # a transfer: inverse-distance weights of three coarse nodes
    def build(self, coarse, fine):
        distance, node = KDTree(coarse.points).query(fine.points, k=3)
        weight = 1 / np.maximum(distance, 1e-12)
        weight /= weight.sum(axis=1, keepdims=True)
        entries = weight.ravel(), (np.repeat(np.arange(fine.n_nodes), 3), node.ravel())
        return sparse.csr_array(entries, shape=(fine.n_nodes, coarse.n_nodes))


class TwoSweeps:  # a smoother: twice the built-in one
    def smooth(self, system, contact, load, unknowns, sweeps):
        return am.ProjectedGaussSeidel().smooth(system, contact, load, unknowns, 2 * sweeps)


class NearContact:  # an indicator: large where y is small
    def indicate(self, hierarchy, result):
        mesh = hierarchy.finest.mesh
        height = mesh.points[mesh.elements].mean(axis=1)[:, 1]
        return am.Estimate(squares=np.exp(-height / 5e-3), norm=1e3)


grids = am.Hierarchy.graded(
    am.cases.greco_bar(), sizes=(10e-3, 6e-3, 3.6e-3), contact_ratio=2, transfer=ThreeNearest()
)
am.plot.history(am.solve(grids, am.FullMultigrid(correction=am.Monotone(), smoother=TwoSweeps())))
# %%
*_, last = am.adapt(
    am.cases.greco_bar(), start=10e-3, indicator=NearContact(), engine=am.Bisect(), max_nodes=1500
)
am.plot.mesh(am.mesh.need_mesh(last.result))
# %%
# **Next:** the same solve with ``am.L2()``. **It depends on** the bar in ten lines.
