"""Sizes by which a problem is judged: of its variables, and of what a plan can change."""
