"""The truncated multigrid from start to end: options, nested start, cycles, what takes over."""
