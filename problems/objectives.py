"""Every static objective by name: a decision and a closed form instead of a plan and dynamics."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from ocp.errors import InputError
from ocp.gradients.objective import SampledObjective
from problems.registry import names, spec
from problems.spec import Citation, ProblemSpec, check_parameters, did_you_mean, lines_of

_MODULES = {
    "heaviside": "problems.heaviside",
    "coulomb": "problems.coulomb",
    "belt-block": "problems.belt_block",
    "ball-wall": "problems.ball_wall",
}


@dataclass(frozen=True)
class ObjectiveSpec:
    """One named objective, at any parameters; ``Params`` holds the decision and ``sigma`` too.

    ``build(params)`` gives the :class:`~ocp.gradients.objective.SampledObjective`; it also takes
    ``backend``, ``threads`` and ``block`` of :class:`dynamics.batch.BatchFunction`.
    """

    name: str
    title: str
    Params: type[BaseModel]
    build: Callable[..., SampledObjective]
    equations: tuple[str, ...]
    citation: Citation

    def params(self, values: Mapping[str, Any]) -> Any:
        """Check ``values`` and fill in the defaults.

        Raises :class:`~ocp.errors.InputError` that names the parameter, its unit and its range.
        """
        return check_parameters(self.name, self.Params, values)

    def objective(self, values: Mapping[str, Any] | None = None) -> SampledObjective:
        """Build the objective at ``values``; raises as :meth:`params` does."""
        return self.build(self.params(values or {}))

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
    if name not in _MODULES:
        raise InputError(
            f"unknown objective {name!r}{did_you_mean(name, _MODULES)}; there are"
            f" {', '.join(_MODULES)}"
        )
    return _registered(name)


@cache
def _registered(name: str) -> ObjectiveSpec:
    module = importlib.import_module(_MODULES[name])
    keys = ("name", "title", "Params", "build", "citation")
    values = {key: getattr(module, key) for key in keys}
    return ObjectiveSpec(**values, equations=lines_of(module.equations))
