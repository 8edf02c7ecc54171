"""The pictures of contact surfaces, and of how contact goes on along a load history."""
