"""The loop solve - estimate - mark - refine: its steps, its levels, its solves and its store."""
