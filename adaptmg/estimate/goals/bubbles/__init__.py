"""Edge bubbles: what a P1 space lacks, where it may move, and the error in it."""
