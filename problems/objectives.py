"""Every static objective by name: a decision and a closed form instead of a plan and dynamics."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from dynamics.systems import ParameterTable, Signal
from ocp.errors import InputError, choose, did_you_mean
from problems.parameters import table, unit_of
from problems.registry import names, spec
from problems.spec import ProblemSpec, Spec, defined

if TYPE_CHECKING:
    from ocp.gradients.objective import ClosedForm, StaticObjective

_MODULES = {
    "heaviside": "problems.heaviside",
    "coulomb": "problems.coulomb",
    "belt-block": "problems.belt_block",
    "ball-wall": "problems.ball_wall",
}
_DECISION, _NOISE = "theta", "sigma"


@dataclass(frozen=True, kw_only=True)
class ObjectiveSpec(Spec):
    """One named objective, at any parameters; ``Params`` holds the decision and ``sigma`` too.

    ``cost(params, theta, p)`` is the expression of the decision's symbol and of the symbols of all
    parameters but these two; ``closed_form(values, sigma)`` is what is known of it.
    """

    cost: Callable[[Any, ca.SX, ParameterTable], ca.SX]
    closed_form: Callable[[dict[str, float], float], ClosedForm] | None = None

    def objective(self, values: Mapping[str, Any] | None = None, **engine: Any) -> StaticObjective:
        """Build the objective at ``values``; ``engine`` is that of its batched evaluation.

        Takes ``backend``, ``threads`` and ``block`` of :class:`dynamics.batch.BatchFunction`;
        raises as :meth:`params` does.
        """
        from ocp.gradients.objective import StaticObjective

        params = self.params(values or {})
        p = ParameterTable(q for q in table(params) if q.name not in (_DECISION, _NOISE))
        field, theta = self.Params.model_fields[_DECISION], ca.SX.sym(_DECISION)
        return StaticObjective(
            self.name,
            (Signal(_DECISION, unit_of(field), field.description or ""),),
            theta,
            self.cost(params, theta, p),
            np.array([getattr(params, _DECISION)]),
            p,
            self.closed_form,
            **engine,
        )

    @property
    def golden(self) -> dict[str, Any]:
        """Known optima: an objective that is only sampled has none."""
        return {}


def named(name: str) -> ObjectiveSpec | ProblemSpec:
    """Return the objective or the contact problem called ``name``, or a problem from a file.

    Raises :class:`~ocp.errors.InputError` for a name that is none of them.
    """
    if name in _MODULES:
        return objective_spec(name)
    known = [*names(), *_MODULES]
    if name.endswith(".py") or name in known:
        return spec(name)
    raise InputError(
        f"unknown problem {name!r}{did_you_mean(name, known)}; there are {', '.join(known)}, or"
        " give the path of a file such as my_problem.py"
    )


def objective_names() -> list[str]:
    """Names of the static objectives."""
    return list(_MODULES)


def objective_spec(name: str) -> ObjectiveSpec:
    """Return the objective called ``name``; raises :class:`~ocp.errors.InputError` for no name."""
    return _registered(choose("objective", name, _MODULES))


@cache
def _registered(module: str) -> ObjectiveSpec:
    return defined(ObjectiveSpec, importlib.import_module(module))
