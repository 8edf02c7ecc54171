"""The linear multigrid below the finest level of the truncated method."""
