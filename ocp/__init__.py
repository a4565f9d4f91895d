"""Optimal control through contact: problems, methods, policies, and judged solutions."""

from ocp.errors import DamagedRun, InputError, NotConverged
from ocp.policy import Feedback, OpenLoop
from ocp.problem import Constraint, Problem, Reference, Scenarios
from ocp.programs.status import Status
from ocp.replay import Replay
from ocp.rollout import Gains, Rollout, roll_out
from ocp.solution import Solution
from ocp.solve import solve
from ocp.stored import load
from ocp.transcription import Direct, MultipleShooting, SingleShooting

__all__ = [
    "Constraint",
    "DamagedRun",
    "Direct",
    "Feedback",
    "Gains",
    "InputError",
    "MultipleShooting",
    "NotConverged",
    "OpenLoop",
    "Problem",
    "Reference",
    "Replay",
    "Rollout",
    "Scenarios",
    "SingleShooting",
    "Solution",
    "Status",
    "load",
    "roll_out",
    "solve",
]
