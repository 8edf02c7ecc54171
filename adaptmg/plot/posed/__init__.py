"""The pictures of what is posed: bodies, contact, loads, supports."""
