"""Studies that a TOML file describes: its keys, how it is read, and what a run does."""
