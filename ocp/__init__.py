"""Optimal control through contact: problems, methods, policies, and judged solutions."""

from importlib import import_module
from typing import TYPE_CHECKING

from ocp.distribution import version  # Imported first: it raises an error if a user's module hides a package.
from ocp.errors import DamagedRun, InputError, NotConverged
from ocp.problem.free_time import free
from ocp.problem.parts import FreeStart, Origin
from ocp.problem.policy import Feedback, OpenLoop
from ocp.problem.problem import Constraint, Problem, Scaling, Scenarios
from ocp.problem.rollout import Gains, Rollout, roll_out
from ocp.problem.sketch import Sketch
from ocp.programs.solver import Status
from ocp.solution import Replay, Solution
from ocp.solve.request import Settings
from ocp.solve.solve import solve
from ocp.store.lookup import load_solution as load
from ocp.store.lookup import save_solution as save
from ocp.transcription import Direct, MultipleShooting, SingleShooting

if TYPE_CHECKING:
    from ocp.continuation.curve import Continuation
    from ocp.continuation.walk import continue_over
    from ocp.jobs.estimate import estimate
    from ocp.jobs.gradients import gradient_report
    from ocp.jobs.sweep import sweep
    from ocp.mpc.controller import Controller
    from ocp.mpc.plants import Disturbance
    from ocp.mpc.simulate import ClosedLoop, simulate
    from ocp.mpcc.complements import complements
    from ocp.mpcc.nlpsol import mpcc_solver
    from ocp.mpcc.opti import opti
    from ocp.mpcc.programs import MPCC

    __version__: str

__all__ = [
    "MPCC",
    "ClosedLoop",
    "Constraint",
    "Continuation",
    "Controller",
    "DamagedRun",
    "Direct",
    "Disturbance",
    "Feedback",
    "FreeStart",
    "Gains",
    "InputError",
    "MultipleShooting",
    "NotConverged",
    "OpenLoop",
    "Origin",
    "Problem",
    "Replay",
    "Rollout",
    "Scaling",
    "Scenarios",
    "Settings",
    "SingleShooting",
    "Sketch",
    "Solution",
    "Status",
    "complements",
    "continue_over",
    "estimate",
    "free",
    "gradient_report",
    "load",
    "mpcc_solver",
    "opti",
    "roll_out",
    "save",
    "simulate",
    "solve",
    "sweep",
]

_LOADED_ON_USE = {
    "MPCC": "ocp.mpcc.programs",
    "ClosedLoop": "ocp.mpc.simulate",
    "Continuation": "ocp.continuation.curve",
    "Controller": "ocp.mpc.controller",
    "Disturbance": "ocp.mpc.plants",
    "complements": "ocp.mpcc.complements",
    "continue_over": "ocp.continuation.walk",
    "estimate": "ocp.jobs.estimate",
    "gradient_report": "ocp.jobs.gradients",
    "mpcc_solver": "ocp.mpcc.nlpsol",
    "opti": "ocp.mpcc.opti",
    "simulate": "ocp.mpc.simulate",
    "sweep": "ocp.jobs.sweep",
}
"""Mapping from public names to their modules, which are imported at first use so that ``import ocp`` is quick."""


# Hidden from type checkers, which would otherwise accept any name in the module.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Return an object of :data:`_LOADED_ON_USE`, or ``__version__``; its module is imported at the first use."""
        if name == "__version__":
            return version()
        if name in _LOADED_ON_USE:
            return getattr(import_module(_LOADED_ON_USE[name]), name)
        raise AttributeError(f"module 'ocp' has no attribute {name!r}")
