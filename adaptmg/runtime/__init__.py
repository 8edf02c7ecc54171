"""What every layer stands on: files written whole, compiled kernels and their cache, threads, values made on demand."""
