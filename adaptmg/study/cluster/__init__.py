"""Runs on the workers of dask.distributed: local processes, or a cluster of the user's.

Loaded only when a study asks for it; distributed is imported in this folder alone.
"""

from __future__ import annotations

from adaptmg.study.cluster.executor import on_cluster, opened
from adaptmg.study.cluster.local import local_cluster

__all__ = ["local_cluster", "on_cluster", "opened"]
