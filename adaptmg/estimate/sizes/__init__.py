"""The sizes of the next mesh: what equilibrates an error, how fast they grow, and as a function of position."""
