"""Edges in a row: oriented boundary edges joined to polylines, and bodies as filled shapes."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib.path import Path

__all__ = ["filled_path", "walks"]


def walks(edges: np.ndarray) -> list[np.ndarray]:
    """Join oriented edges (n, 2) to walks of nodes, each edge used once.

    Open walks come first, by the number of their first node; then rings, whose last node is their first (rings that
    touch in a node are one).

    Parameters
    ----------
    edges : (n, 2) int array
        From node to node.

    Returns
    -------
    list of int arrays
    """
    following: dict[int, list[int]] = defaultdict(list)
    surplus: dict[int, int] = defaultdict(int)
    for a, b in np.asarray(edges).tolist():
        following[a].append(b)
        surplus[a] += 1
        surplus[b] -= 1

    def walk_from(start: int) -> np.ndarray:
        walk = [start]
        while following[walk[-1]]:
            walk.append(following[walk[-1]].pop())
        return np.array(walk)

    nodes = sorted(following)
    found = [walk_from(node) for node in nodes for _ in range(max(surplus[node], 0))]
    # what is left enters each node as often as it leaves it: a walk ends only where it began
    return found + [walk_from(node) for node in nodes if following[node]]


def filled_path(points: np.ndarray, rings: list[np.ndarray]) -> Path:
    """One closed path of rings of nodes; holes run clockwise and stay empty.

    Parameters
    ----------
    points : (n, 2) array
    rings : list of int arrays
        As :func:`walks` returns them.
    """
    vertices = [points[ring] for ring in rings]
    codes = [np.r_[Path.MOVETO, np.full(len(ring) - 2, Path.LINETO), Path.CLOSEPOLY] for ring in rings]
    return Path(np.concatenate(vertices), np.concatenate(codes))
