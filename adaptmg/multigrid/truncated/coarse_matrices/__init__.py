"""What the truncation of contact nodes changes in the matrices of the coarser levels."""
