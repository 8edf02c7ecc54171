"""Runs of a store as tables, on the terminal and in files."""
