"""Optimal control through contact: problems, methods, policies, and judged solutions."""

from typing import TYPE_CHECKING

from ocp.distribution import version  # first: it sees to it that what follows is ours
from ocp.errors import DamagedRun, InputError, NotConverged
from ocp.free_time import free
from ocp.policy import Feedback, OpenLoop
from ocp.problem import Constraint, Problem, Scaling, Scenarios
from ocp.programs.solver import Status
from ocp.request import Settings
from ocp.rollout import Gains, Rollout, roll_out
from ocp.solution import Replay, Solution
from ocp.solve import solve
from ocp.store.lookup import load_solution as load
from ocp.transcription import Direct, MultipleShooting, SingleShooting

if TYPE_CHECKING:
    from ocp.gradients.estimate import estimate

    __version__: str

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
    "Replay",
    "Rollout",
    "Scaling",
    "Scenarios",
    "Settings",
    "SingleShooting",
    "Solution",
    "Status",
    "estimate",
    "free",
    "load",
    "roll_out",
    "solve",
]


# Not for a type checker, to which any name would then be one of ours.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Load ``estimate`` and look up ``__version__`` at the first use."""
        if name == "__version__":
            return version()
        if name == "estimate":
            from ocp.gradients.estimate import estimate

            return estimate
        raise AttributeError(f"module 'ocp' has no attribute {name!r}")
