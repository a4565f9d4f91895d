"""Runs in motion: what is seen at which time, and the files that show it."""
