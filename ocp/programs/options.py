"""Options of the solvers by name, with their types, ranges and limits."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca

from ocp.errors import InputError, did_you_mean

LOOSEST = {
    **dict.fromkeys(("tol", "acceptable_tol", "dual_inf_tol", "opt_tol", "dual_tolerance"), 1e-4),
    **dict.fromkeys(("constr_viol_tol", "acceptable_constr_viol_tol", "compl_inf_tol"), 1e-6),
    **dict.fromkeys(("feas_tol", "slack_tol", "primal_tolerance"), 1e-6),
}
"""Largest tolerances: of constraints what the audit demands, of optimality what the certificate
does; a solver that stops earlier proves nothing."""
_UNO = {
    **dict.fromkeys(("primal_tolerance", "dual_tolerance", "time_limit"), "real"),
    **dict.fromkeys(("loose_primal_tolerance", "loose_dual_tolerance"), "real"),
    **dict.fromkeys(("max_iterations", "loose_tolerance_iteration_threshold"), "integer"),
    **dict.fromkeys(("preset", "logger", "linear_solver", "hessian_model"), "string"),
    **dict.fromkeys(("globalization_mechanism", "globalization_strategy"), "string"),
    **dict.fromkeys(("constraint_relaxation_strategy", "residual_norm"), "string"),
    "inequality_handling_method": "string",
}
"""Uno's options; it takes any other name without a word."""
_WORDS = {"integer": "a whole number", "real": "a finite number", "string": "a word"}
_MOST = 2**31 - 1


@dataclass(frozen=True)
class Option:
    """An option's type, ``integer``, ``real`` or ``string``, its range and its words, if any.

    ``default`` and ``meaning`` are quoted from the solver's documentation, where known.
    """

    kind: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    words: Sequence[str] = ()
    default: str = ""
    meaning: str = ""

    def takes(self, value: Any) -> bool:
        """Whether ``value`` is of the type and within the range."""
        if self.kind == "string":
            return isinstance(value, str) and (not self.words or value in self.words)
        if isinstance(value, bool | str) or not math.isfinite(value):
            return False
        if self.kind == "integer" and (value != int(value) or abs(value) > _MOST):
            return False
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below

    @property
    def expected(self) -> str:
        """What it takes, in words."""
        if self.words:
            return f"one of {', '.join(self.words)}"
        low = f" {'>' if self.open_low else '>='} {self.low:g}" if math.isfinite(self.low) else ""
        high = f" {'<' if self.open_high else '<='} {self.high:g}" if self.high < 1e300 else ""
        return f"{_WORDS[self.kind]}{low}{' and' if low and high else ''}{high}"


INTERFACE: dict[str, dict[str, Option]] = {
    "sleqp": {
        "max_iter": Option("integer", 1),
        "max_wall_time": Option("real", 0.0, open_low=True),
        "print_level": Option("integer", 0, 4),
    }
}
"""Options that CasADi's interface to a solver takes itself, beside those it hands on."""


def documented(solver: str) -> dict[str, Option]:
    """The documented options of a solver; the others are probed.

    IPOPT documents its own; of Uno the names are known, of fatrop and SLEQP nothing.
    """
    if solver == "uno":
        return {name: Option(kind) for name, kind in _UNO.items()}
    return _ipopt() if solver == "ipopt" else {}


def check_options(solver: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``options`` as the solver takes them: yes and no for true and false, integers whole.

    Raises :class:`~ocp.errors.InputError` for a name that the solver does not have, a value of
    another type or out of range, and a tolerance above :data:`LOOSEST`.
    """
    checked: dict[str, Any] = {}
    for name, setting in options.items():
        option, value = _option(solver, name), setting
        if isinstance(setting, bool) and option.kind == "string":
            value = "yes" if setting else "no"
        if not option.takes(value):
            raise InputError(f"{solver} refused its options: {name} must be {option.expected}, got {value!r}")
        if name in LOOSEST and float(value) > LOOSEST[name]:
            raise InputError(
                f"{solver} refused its options: {name} must be at most {LOOSEST[name]:g}, got"
                f" {value:g}; a looser tolerance proves nothing"
            )
        checked[name] = int(value) if option.kind == "integer" else value
    return checked


def has_option(solver: str, name: str) -> bool:
    """Whether the solver has an option of this name."""
    try:
        _option(solver, name)
    except InputError:
        return False
    return True


def _option(solver: str, name: str) -> Option:
    if documented_options := documented(solver):
        if name in documented_options:
            return documented_options[name]
        raise InputError(f"{solver} refused its options: it has no {name!r}{did_you_mean(name, documented_options)}")
    interface_options = INTERFACE.get(solver, {})
    return interface_options[name] if name in interface_options else _probed(solver, name)


@cache
def _ipopt() -> dict[str, Option]:
    """IPOPT's options as it documents them itself (``print_options_documentation``, 3.14)."""
    text = Path(__file__).with_name("ipopt_options.json").read_text(encoding="utf-8")
    return {name: Option(**stated) for name, stated in json.loads(text).items()}


@cache
def _probed(solver: str, name: str) -> Option:
    """Type of an option of a plugin that CasADi reads itself: which cast of a word it refuses."""
    y = ca.MX.sym("y", 2)
    nlp = {"x": y, "f": ca.sumsqr(y - 1), "g": y[0] + y[1]}
    try:
        ca.nlpsol("probe", solver, nlp, {"print_time": False, solver: {name: "a word"}})(x0=0)
    except RuntimeError as error:
        for cast, kind in (("int", "integer"), ("double", "real"), ("bool", "integer")):
            if f'"is_{cast}()"' in str(error):
                return Option(kind)
        reason = str(error).strip().splitlines()[-1]
        if name in reason:
            reason = reason.partition(": ")[2] or reason
            raise InputError(f"{solver} refused its options: {reason}") from error
    return Option("string")
