"""Optimal control through contact: problems, methods, policies, and judged solutions."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from ocp.distribution import version  # Imported first: it raises an error if a user's module hides a package.

if TYPE_CHECKING:
    from ocp.continuation.curve import Continuation
    from ocp.continuation.walk import continue_over
    from ocp.errors import DamagedRun, InputError, NotConverged
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

_MODULES = {
    "ocp.continuation.curve": ("Continuation",),
    "ocp.continuation.walk": ("continue_over",),
    "ocp.errors": ("DamagedRun", "InputError", "NotConverged"),
    "ocp.jobs.estimate": ("estimate",),
    "ocp.jobs.gradients": ("gradient_report",),
    "ocp.jobs.sweep": ("sweep",),
    "ocp.mpc.controller": ("Controller",),
    "ocp.mpc.plants": ("Disturbance",),
    "ocp.mpc.simulate": ("ClosedLoop", "simulate"),
    "ocp.mpcc.complements": ("complements",),
    "ocp.mpcc.nlpsol": ("mpcc_solver",),
    "ocp.mpcc.opti": ("opti",),
    "ocp.mpcc.programs": ("MPCC",),
    "ocp.problem.free_time": ("free",),
    "ocp.problem.parts": ("FreeStart", "Origin"),
    "ocp.problem.policy": ("Feedback", "OpenLoop"),
    "ocp.problem.problem": ("Constraint", "Problem", "Scaling", "Scenarios"),
    "ocp.problem.rollout": ("Gains", "Rollout", "roll_out"),
    "ocp.problem.sketch": ("Sketch",),
    "ocp.programs.solver": ("Status",),
    "ocp.solution": ("Replay", "Solution"),
    "ocp.solve.request": ("Settings",),
    "ocp.solve.solve": ("solve",),
    "ocp.store.lookup": ("load_solution", "save_solution"),
    "ocp.transcription": ("Direct", "MultipleShooting", "SingleShooting"),
}
"""Mapping from modules to their public names: a module is imported when one of its names is first used."""
_LOADED_ON_USE = {name.removesuffix("_solution"): (module, name) for module in _MODULES for name in _MODULES[module]}
"""Mapping from each public name to its module, and to its name there."""


class _Package(ModuleType):
    """Module whose ``solve`` remains the function: the import of the folder ``ocp.solve`` would replace it."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name == "solve" and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

# Hidden from type checkers, which would otherwise accept any name in the module.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Return an object of :data:`_LOADED_ON_USE`, or ``__version__``; its module is imported at the first use."""
        if name == "__version__":
            return version()
        if name not in _LOADED_ON_USE:
            raise AttributeError(f"module 'ocp' has no attribute {name!r}")
        module, public_name = _LOADED_ON_USE[name]
        return getattr(import_module(module), public_name)
