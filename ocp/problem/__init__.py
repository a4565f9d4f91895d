"""Optimal control problems: costs, constraints, policies, free final times, characteristic sizes, and rollouts."""

from ocp.problem.problem import Constraint, Problem, Scaling, Scenarios

__all__ = ["Constraint", "Problem", "Scaling", "Scenarios"]
