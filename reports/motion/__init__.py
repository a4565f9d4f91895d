"""Animations of runs, and the files that show them."""
