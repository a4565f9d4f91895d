"""A solve: from a checked request, or from a solution, to a judged answer."""

from ocp.solve.solve import solve

__all__ = ["solve"]
