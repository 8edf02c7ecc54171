"""How load histories go from step to step, and how they are kept."""
