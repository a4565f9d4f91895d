"""Parts of a problem: expressions, constraints, characteristic sizes, scenarios and a free start."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from pydantic import InstanceOf

from ocp.errors import InputError, abbreviated
from ocp.programs.units import SI, Units
from ocp.validation import Count, Index, Line, Name, NotNegative, Positive, Recorded, validate_fields, validated


def column(label: str, value: Any, *sizes: int) -> ca.SX:
    """Return numbers or an expression as a column; its number of entries must be one of ``sizes``.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    expression = _expression(value)
    if expression is None:
        raise InputError(f"{label} must be numbers or an expression of ca.SX, got {abbreviated(value)}")
    if min(expression.shape) > 1:
        raise InputError(f"{label} must be a column, got a matrix of shape {expression.shape}")
    if sizes and expression.numel() not in sizes:
        raise InputError(f"{label} has {expression.numel()} entries, expected {sizes[0]}")
    return ca.vec(expression)


def repeat_bound(bound: ca.SX | float, size: int) -> ca.SX:
    """Return a bound as a column of ``size`` entries; a single number is repeated."""
    column = ca.SX(bound)
    return ca.repmat(column, size // max(column.numel(), 1), 1)


def _expression(value: Any) -> ca.SX | None:
    if isinstance(value, np.ndarray | list | tuple) and not _numbers(value):
        return None
    if not isinstance(value, ca.SX | ca.DM | int | float | np.generic | np.ndarray | list | tuple):
        return None
    if isinstance(value, bool | np.bool_ | np.complexfloating | np.str_ | np.bytes_):
        return None
    return ca.SX(value.item() if isinstance(value, np.generic) else value)


def _numbers(values: Any) -> bool:
    try:
        return np.asarray(values).dtype.kind in "if"
    except (ValueError, TypeError, OverflowError):
        return False


@dataclass(frozen=True, eq=False)
class Constraint:
    """Constraint ``lower <= expression <= upper`` on an expression in (x, u, p), or (x, p) if it is terminal.

    A single bound holds for every entry.

    Raises :class:`~ocp.errors.InputError` if the expression or a bound is not a column.
    """

    name: str
    expression: ca.SX
    lower: ca.SX | float
    upper: ca.SX | float

    def __post_init__(self) -> None:
        name = validated("a constraint's name", self.name, Name)
        expression = column(f"constraint {name}", self.expression)
        object.__setattr__(self, "expression", expression)
        for side in ("lower", "upper"):
            bound = column(f"{side} of constraint {name}", getattr(self, side), expression.numel(), 1)
            object.__setattr__(self, side, repeat_bound(bound, expression.numel()))


@dataclass(frozen=True)
class Scaling:
    """Characteristic sizes of contact impulses, gaps, states and inputs, as stated by the user.

    ``x`` and ``u`` scale the perturbation of guesses in a multi-start and the differences that judges
    compare. All are multiples of the natural ``units`` of their signals, so that no size depends on
    the units of the parameters. A size that is None is derived from the problem's data
    (:mod:`ocp.problem.sizes`); :attr:`~Problem.scales` returns all sizes in SI units.

    Raises :class:`~ocp.errors.InputError` for a size that is not positive and finite.
    """

    impulse: float | None = None
    gap: float | None = None
    x: float | None = None
    u: float | None = None
    units: Units = SI

    def __post_init__(self) -> None:
        sizes = dict.fromkeys(("impulse", "gap", "x", "u"), Positive | None)
        validate_fields(self, "scaling", **sizes, units=InstanceOf[Units] | None)

    @property
    def derived(self) -> tuple[str, ...]:
        """Names of the sizes that are None and therefore derived from the problem's data."""
        return tuple(name for name in ("impulse", "gap", "x", "u") if getattr(self, name) is None)


@dataclass(frozen=True)
class Scales:
    """Characteristic sizes of impulses, gaps, states (nx,), inputs (nu,) and the cost."""

    impulse: float
    gap: float
    x: np.ndarray
    u: np.ndarray
    cost: float = 1.0

    @property
    def mu(self) -> float:
        """Characteristic mu, ``impulse * gap``, at which homotopies start."""
        return self.impulse * self.gap

    def relative_to(self, units: Scales) -> Scales:
        """Return these sizes as multiples of ``units``."""
        return Scales(
            self.impulse / units.impulse,
            self.gap / units.gap,
            self.x / units.x,
            self.u / units.u,
            self.cost / units.cost,
        )


@dataclass(frozen=True)
class Origin:
    """Provenance of a problem, which runs store and no equation uses.

    ``settings`` are parameters that are not symbols, such as ``N``; ``citation`` is a key of the bibliography.
    ``source`` is the user's file that built the problem, None for a named problem or a problem made in Python;
    ``source_digest`` is the digest of this file and all files that it uses (:mod:`problems.source_digest`), and
    ``record`` is the :class:`problems.spec.UserProblemRecord` of its runs.

    Raises :class:`~ocp.errors.InputError` for settings that no run can store, and for a citation of several lines.
    """

    settings: dict[str, float | int | str] = field(default_factory=dict)
    citation: str = ""
    source: str | None = None
    source_digest: str | None = None
    record: Any = None

    def __post_init__(self) -> None:
        validate_fields(self, "origin", settings=dict[Line, Recorded], citation=Line)


@dataclass(frozen=True)
class Scenarios:
    """Initial states ``x0 + std * e_i``, i < n, with standard normal e_i drawn from ``seed``.

    ``std`` (nx,) is in the units of the states. With n = 1 the only scenario is the nominal start.

    Raises :class:`~ocp.errors.InputError` for n < 1, and for a negative ``std`` or seed.
    """

    n: int = 1
    std: tuple[float, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "std", np.ravel(self.std).tolist())
        validate_fields(self, "scenarios", n=Count, std=tuple[NotNegative, ...], seed=Index)

    def offsets(self, nx: int) -> np.ndarray:
        """Return the offsets (n, nx) from the nominal start; a single scenario has offset zero."""
        if self.n == 1:
            return np.zeros((1, nx))
        noise = np.random.default_rng(self.seed).standard_normal((self.n, nx))
        return noise * np.asarray(self.std)


@dataclass(frozen=True, eq=False)
class FreeStart:
    """An optimised initial state ``lower <= x_0 <= upper``, with ``Problem.x0`` as its guess.

    ``x_N[i] = x_0[i]`` holds for i in ``periodic``. ``lower`` and ``upper`` (nx, 1) are expressions in the parameters.
    """

    lower: ca.SX
    upper: ca.SX
    periodic: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for side in ("lower", "upper"):
            bound = column(f"{side} of the start", getattr(self, side))
            object.__setattr__(self, side, bound)
        periodic = validated("periodic of the start", self.periodic, tuple[Index, ...])
        object.__setattr__(self, "periodic", tuple(dict.fromkeys(periodic)))

    def check(self, name: str, nx: int) -> None:
        """Raise :class:`~ocp.errors.InputError` if the start does not fit ``nx`` states."""
        column(f"{name}: lower of the start", self.lower, nx, 1)
        column(f"{name}: upper of the start", self.upper, nx, 1)
        if any(index >= nx for index in self.periodic):
            raise InputError(
                f"{name}: periodic of the start names state {max(self.periodic)}, but states are"
                f" counted from 0 to {nx - 1}"
            )
