"""Figures to be set in a paper: bare, lettered, as wide as a column."""
