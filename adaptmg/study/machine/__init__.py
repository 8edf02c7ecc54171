"""What a row says of the process that made it: memory, commit."""
