"""Drawings of runs and machines: shapes, strobes, forces, symbols, and the style of all figures."""
