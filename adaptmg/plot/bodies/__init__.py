"""The pictures of deformed bodies."""
