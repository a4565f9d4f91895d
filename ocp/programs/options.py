"""Options of the solvers, with their types and ranges, and the monitor behind an option that IPOPT lacks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Unpack

import casadi as ca

from dynamics.settings import Range, Setting, declare
from ocp.errors import InputError, did_you_mean

LOOSEST = {
    **dict.fromkeys(("tol", "acceptable_tol", "dual_inf_tol", "opt_tol", "dual_tolerance"), 1e-4),
    **dict.fromkeys(("constr_viol_tol", "acceptable_constr_viol_tol", "compl_inf_tol"), 1e-6),
    **dict.fromkeys(("feas_tol", "slack_tol", "primal_tolerance"), 1e-6),
}
"""Maximum tolerances that a user may set: the audit's for constraints, the certificate's for optimality."""
SHORT_STEP = 0.02
"""Fraction of a Newton step below which a step of IPOPT is short."""
MAX_SHORT_STEPS = 24
"""Number of short steps in a row after which a run that may be abandoned ends.

Of the runs of 20 named problems and 30 others, no run with more than 19 short steps in a row converged. A run that
stays at a bound in this way also has dense factorisations: 128 iterations took 85 s where others take 8 s."""
_CHECK_INTERVAL = 8
"""Number of iterations between checks, since CasADi copies the whole history at each."""
ABANDONS = "abandons_short_steps"
"""Name of the option with which a run of IPOPT ends after :data:`MAX_SHORT_STEPS` short steps."""
_UNO = {
    **dict.fromkeys(("primal_tolerance", "dual_tolerance", "time_limit"), "real"),
    **dict.fromkeys(("loose_primal_tolerance", "loose_dual_tolerance"), "real"),
    **dict.fromkeys(("max_iterations", "loose_tolerance_iteration_threshold"), "integer"),
    **dict.fromkeys(("preset", "logger", "linear_solver", "hessian_model"), "string"),
    **dict.fromkeys(("globalization_mechanism", "globalization_strategy"), "string"),
    **dict.fromkeys(("constraint_relaxation_strategy", "residual_norm"), "string"),
    "inequality_handling_method": "string",
}
"""Types of Uno's options; they are listed here because Uno silently ignores unknown options."""
MAX_INTEGER = 2**31 - 1
"""Maximum value of a solver's integer options."""
_TYPES: dict[str, Any] = {"integer": int, "real": float, "string": str}


def _option(
    name: str, kind: str, meaning: str = "", default: str = "", words: Sequence[str] = (), **limits: Unpack[Range]
) -> Setting:
    """Declare an option; ``default`` and ``meaning`` are quoted from the solver's documentation, if known."""
    if kind == "integer":
        limits = {"most": MAX_INTEGER, **limits}
    declaration = declare(..., meaning, limits=limits, words=list(words), documented_default=default)
    return Setting(name, declaration, _TYPES[kind])


INTERFACE: dict[str, dict[str, Setting]] = {
    "sleqp": {
        "max_iter": _option("max_iter", "integer", least=1),
        "max_wall_time": _option("max_wall_time", "real", above=0),
        "print_level": _option("print_level", "integer", least=0, most=4),
    }
}
"""Options that CasADi's interface to a solver reads, in addition to those that it passes to the solver."""


def documented(solver: str) -> dict[str, Setting]:
    """Return the known options of a solver: IPOPT's documented options, or names and types of Uno's.

    The result is empty for fatrop and SLEQP, whose options are probed.
    """
    if solver == "uno":
        return {name: _option(name, kind) for name, kind in _UNO.items()}
    return _ipopt() if solver == "ipopt" else {}


def check_options(solver: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``options`` converted to the solver's types: yes and no for True and False, int for whole numbers.

    Raises :class:`~ocp.errors.InputError` for a name that the solver does not have, a value of
    another type or out of range, and a tolerance above :data:`LOOSEST`.
    """
    checked: dict[str, Any] = {}
    for name, value in options.items():
        option = _find_option(solver, name)
        if isinstance(value, bool) and option.annotation is str:
            value = "yes" if value else "no"
        checked[name] = option.read(value, f"{solver} rejected its options: ")
        if name in LOOSEST and checked[name] > LOOSEST[name]:
            raise InputError(
                f"{solver} rejected its options: {name} must be at most {LOOSEST[name]:g}, got"
                f" {value:g}; a looser tolerance proves nothing"
            )
    return checked


def has_option(solver: str, name: str) -> bool:
    """Return whether the solver has an option with this name."""
    try:
        _find_option(solver, name)
    except InputError:
        return False
    return True


def _find_option(solver: str, name: str) -> Setting:
    if documented_options := documented(solver):
        if name in documented_options:
            return documented_options[name]
        raise InputError(f"{solver} rejected its options: it has no {name!r}{did_you_mean(name, documented_options)}")
    interface_options = INTERFACE.get(solver, {})
    return interface_options[name] if name in interface_options else _probe_option(solver, name)


@cache
def _ipopt() -> dict[str, Setting]:
    """Return IPOPT's options as documented by IPOPT (``print_options_documentation``, 3.14)."""
    text = Path(__file__).with_name("ipopt_options.json").read_text(encoding="utf-8")
    return {name: _option(name, **stated) for name, stated in json.loads(text).items()}


@cache
def _probe_option(solver: str, name: str) -> Setting:
    """Return an option of a solver; its type is read from the error message when the option is set to a word."""
    y = ca.MX.sym("y", 2)
    nlp = {"x": y, "f": ca.sumsqr(y - 1), "g": y[0] + y[1]}
    try:
        ca.nlpsol("probe", solver, nlp, {"print_time": False, solver: {name: "a word"}})(x0=0)
    except RuntimeError as error:
        for cast, kind in (("int", "integer"), ("double", "real"), ("bool", "integer")):
            if f'"is_{cast}()"' in str(error):
                return _option(name, kind)
        reason = str(error).strip().splitlines()[-1]
        if name in reason:
            reason = reason.partition(": ")[2] or reason
            raise InputError(f"{solver} rejected its options: {reason}") from error
    return _option(name, "string")


class ShortSteps(ca.Callback):
    """Monitor that ends a run of IPOPT after :data:`MAX_SHORT_STEPS` short steps in a row.

    ``calls`` counts the iterates of a run, and is set to zero before it.
    """

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.monitored: ca.Function | None = None
        self.calls = 0
        self.construct("short_steps", {})

    def get_n_in(self) -> int:
        """Return the number of arguments, the outputs of a solver."""
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return an empty pattern: no argument is read."""
        return ca.Sparsity(0, 0)

    def eval(self, arguments: Sequence[ca.DM]) -> list[int]:
        """Return 1 to end the run, else 0."""
        assert self.monitored is not None
        self.calls += 1
        if self.calls % _CHECK_INTERVAL:
            return [0]
        steps = self.monitored.stats()["iterations"]["alpha_pr"][-MAX_SHORT_STEPS:]
        return [int(len(steps) == MAX_SHORT_STEPS and max(steps) < SHORT_STEP)]
