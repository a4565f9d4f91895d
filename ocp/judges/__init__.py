"""Judges of a solution, what they found, and the words for it."""
