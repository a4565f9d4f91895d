"""Particles through a noisy model, and total propagation of gradients along them."""

from ocp.learning.total_propagation.algorithm import TotalPropagation

__all__ = ["TotalPropagation"]
