"""Parameters of a named problem: validated numbers with units, and their symbols."""

from __future__ import annotations

from typing import Any, Unpack

import casadi as ca
from pydantic import BaseModel, ConfigDict, Field

from dynamics.settings import Range, Setting, declare, settings_of
from dynamics.systems import ContactSystem, Parameter, ParameterTable
from ocp.problem.cost_sizes import cost_weights
from ocp.problem.problem import Problem
from ocp.programs.units import SI, Units, fit_units


class Parameters(BaseModel):
    """Base class of a problem's parameters: immutable and finite; unknown names are rejected.

    A ``float`` field becomes a symbol that a study may vary. An ``int`` field, or a field made by
    :func:`structure`, sets the structure of the problem (horizon, number of scenarios, seed) and stays a
    number.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


def quantity(default: float, unit: str, meaning: str, **limits: Unpack[Range]) -> Any:
    """Declare a scalar in SI ``unit`` with its range, see :class:`~dynamics.settings.Range`."""
    return declare(default, meaning, unit, limits)


def structure(default: float, meaning: str, *, unit: str = "1", **limits: Unpack[Range]) -> Any:
    """Declare a number >= 0 that sets the problem's structure, such as its horizon, and never becomes a symbol."""
    return declare(default, meaning, unit, {"least": 0, **limits}, structural=True)


def choice(words: tuple[str, ...], meaning: str) -> Any:
    """Declare a parameter whose value is one of ``words`` (default: the first); it never becomes a symbol."""
    return Field(
        words[0],
        pattern=f"^({'|'.join(words)})$",
        description=meaning,
        json_schema_extra={"structural": True, "words": list(words)},
    )


def is_structural(parameter: Setting) -> bool:
    """Return whether the parameter sets the problem's structure instead of becoming a symbol."""
    return parameter.annotation is not float or bool(parameter.extra("structural", False))


def table(params: BaseModel) -> ParameterTable:
    """Return a table of new symbols for the parameters that are not structural, with their values as defaults."""
    return ParameterTable(
        Parameter(name, float(getattr(params, name)), about.unit, about.meaning)
        for name, about in settings_of(type(params)).items()
        if not is_structural(about)
    )


def natural_units(params: BaseModel, problem: Problem) -> Units:
    """Return units that fit the ratios of a problem's parameters to their defaults; SI units if all ratios are 1.

    Words, structural parameters, and parameters that are zero or have changed sign are left out. See
    :func:`~ocp.programs.units.fit_units`.
    """
    symbols = {name: about for name, about in settings_of(type(params)).items() if not is_structural(about)}
    ratios = {
        name: float(getattr(params, name)) / float(about.default)
        for name, about in symbols.items()
        if isinstance(about.default, int | float) and about.default
    }
    if all(ratio == 1 for ratio in ratios.values()):
        return SI
    # The effect of a single weight equals that of another unit of the cost.
    weights = cost_weights(problem)
    weights = weights if len(weights) > 1 else set()
    return fit_units((symbols[name].unit, ratio, name in weights) for name, ratio in ratios.items())


def friction_of(p: ParameterTable) -> tuple[ParameterTable, ca.SX | None]:
    """Return the parameters and the friction coefficient; without friction, the other parameters and None.

    A central path needs a friction cone with an interior. Therefore a system whose coefficient is zero has
    no friction pairs, and no parameter ``friction`` that could be varied.
    """
    if p.get("friction").value > 0:
        return p, p["friction"]
    return ParameterTable(parameter for parameter in p if parameter.name != "friction"), None


def pose_problem(params: Any, system: ContactSystem, **parts: Any) -> Problem:
    """Return the problem of ``params.N`` steps of ``system``, with the name and parameters of the system.

    Inputs are bounded by ``±u_max`` if there is such a parameter; ``parts`` are the other fields of
    :class:`~ocp.problem.problem.Problem`.
    """
    p = system.parameters
    if "u_max" in p.names:
        parts = {"u_lower": -p["u_max"], "u_upper": p["u_max"], **parts}
    return Problem(name=system.name, system=system, N=params.N, parameters=p, **parts)
