"""Model-based policy optimisation; what needs JAX is loaded when a training begins."""

from ocp.learning.mbpo.algorithm import MBPO

__all__ = ["MBPO"]
