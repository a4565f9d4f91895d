"""Particles through a noisy model, and total propagation of gradients along them."""

from ocp.learning.pipps.algorithm import PIPPS

__all__ = ["PIPPS"]
