"""Drawing in three dimensions."""
