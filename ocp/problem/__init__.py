"""Optimal control problems: costs, constraints, policies, free times, sizes, and rollouts of them."""

from ocp.problem.problem import Constraint, Problem, Scaling, Scenarios

__all__ = ["Constraint", "Problem", "Scaling", "Scenarios"]
