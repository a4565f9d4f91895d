"""Animations of runs, and the files that contain them."""
