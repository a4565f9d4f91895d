"""A solve: from a checked request, or from a solution, to a judged solution."""

from ocp.solve.solve import solve

__all__ = ["solve"]
