"""Algorithms that follow gradients of truncated unrolls, and what these have in common."""
