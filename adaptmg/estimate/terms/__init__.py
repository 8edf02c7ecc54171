"""The parts of the residual indicator, each a module: squares by element (n_elements,), N m."""
