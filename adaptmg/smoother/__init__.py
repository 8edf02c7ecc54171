"""The projected block Gauss-Seidel smoother: numba kernels on arrays, and one thin wrapper."""
