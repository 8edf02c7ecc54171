"""The truncated nonsmooth Newton multigrid: its options, its step and the parts of the step."""
