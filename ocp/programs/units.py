"""Units of mass, length, time and cost that fit the numbers of a problem.

A problem's characteristic sizes are stated at its default parameters. At other parameters, for example in
other units, the sizes are multiplied by natural units fitted to the changes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import scipy.sparse as sp

DIMENSIONS = {
    "kg": (1, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "J": (1, 2, -2),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
    **dict.fromkeys(("g", "t", "lb"), (1, 0, 0)),
    **dict.fromkeys(("km", "cm", "mm", "um", "nm", "ft", "in"), (0, 1, 0)),
    **dict.fromkeys(("ms", "us"), (0, 0, 1)),
}
"""Exponents of kg, m and s in basic units, of which other units are products. A problem uses one unit of each kind."""
SMOOTHING = 1e-3
"""Absolute logarithm of a ratio below which the absolute value is smoothed."""
REWEIGHTINGS = 60
"""Number of reweighted least-squares problems that are solved to fit the units."""
SLIGHT_CHANGE = 0.05
"""Absolute logarithm of a ratio below which a parameter counts as unchanged."""
COST_UNIT_VOTE = 0.75
"""Weight of the equation "the unit of the cost is unchanged", so that changing one of two weights has no effect."""


def dimension(unit: str) -> np.ndarray | None:
    """Return the exponents of kg, m and s in a unit such as ``1/(N^2 s)``; None for an unknown unit."""
    total, sign = np.zeros(3), 1
    for token in re.findall(r"/|\((?:[^)]*)\)(?:\^-?\d+)?|[^\s/()]+", unit.replace("²", "^2")):
        if token == "/":
            sign = -1
            continue
        symbol, _, power = token.rpartition("^") if re.search(r"\^-?\d+$", token) else (token, "", "1")
        inner = dimension(symbol[1:-1]) if symbol.startswith("(") else DIMENSIONS.get(symbol)
        if inner is None:
            return None
        total += sign * float(power) * np.asarray(inner)
        sign = 1
    return total


@dataclass(frozen=True)
class Units:
    """Natural units of mass [kg], length [m], time [s] and of the cost."""

    kg: float = 1.0
    m: float = 1.0
    s: float = 1.0
    cost: float = 1.0

    def of(self, unit: str) -> float:
        """Return the natural unit with the dimension of ``unit``, as a multiple of ``unit``; 1 for an unknown unit."""
        exponents = dimension(unit)
        if exponents is None:
            return 1.0
        return float(np.prod(np.array([self.kg, self.m, self.s]) ** exponents))

    @property
    def is_si(self) -> bool:
        """Whether the units of mass, length and time are kg, m and s."""
        return (self.kg, self.m, self.s) == (1.0, 1.0, 1.0)


SI = Units()
"""SI units, with the unit of the cost unchanged."""


def fit_units(changes: Iterable[tuple[str, float, bool]]) -> Units:
    """Return natural units fitted to ``changes``.

    Each change is a parameter's unit, the ratio of its value to the default, and whether it is a weight of
    the cost. The fit is ``min over c of sum_i |log ratio_i - e_i' c|`` with the exponents e_i of the unit
    (and of the cost, 1 for a weight), smoothed at 1e-3 and solved by reweighted least squares, then by
    least squares over the parameters that fit. A change of units is fitted exactly even if a few
    parameters changed in addition. If all units differ by less than 5 % from SI units, SI units are returned.
    """
    known_changes = [(dimension(unit), weighs, ratio) for unit, ratio, weighs in changes if ratio > 0]
    rows = [((*e, weighs), np.log(ratio)) for e, weighs, ratio in known_changes if e is not None]
    votes = np.append(np.ones(len(rows)), COST_UNIT_VOTE)
    E = np.array([*(e for e, _ in rows), (0, 0, 0, 1)], dtype=float)
    y = np.array([*(ratio for _, ratio in rows), 0.0])
    c = np.linalg.lstsq(E, y, rcond=None)[0]
    for _ in range(REWEIGHTINGS):
        weight = np.sqrt(votes) * ((y - E @ c) ** 2 + SMOOTHING**2) ** -0.25
        c = np.linalg.lstsq(weight[:, None] * E, weight * y, rcond=None)[0]
    residuals = y - E @ c
    is_met = np.abs(residuals) < SLIGHT_CHANGE
    c += np.linalg.lstsq(E[is_met], residuals[is_met], rcond=None)[0]
    return Units() if np.abs(c).max() < SLIGHT_CHANGE else Units(*np.exp(c).tolist())


def cost_unit(span: float) -> float:
    """Return the power of 2**24 that scales a cost's span into 2**-6 ... 2**18; 1 for an invalid span.

    Tolerances of solvers suit this whole range, so a cost within it is not scaled.
    """
    usable = np.isfinite(span) and span > 0
    return 2.0 ** (24 * np.floor((np.log2(span) + 6) / 24)) if usable else 1.0


ORDINARY_ROWS = 13
"""Exponent of two up to which a row is not scaled, since solvers scale rows themselves."""


def solver_unit(sizes: Any, ordinary: int = 7) -> np.ndarray:
    """Return the power of two nearest to each size, 1 for ordinary and for invalid sizes.

    Ordinary sizes are from ``2**-ordinary`` to ``2**ordinary``, which suits a solver's tolerances.
    """
    sizes = np.asarray(sizes, dtype=float)
    usable = np.isfinite(sizes) & (sizes > 0)
    exponents = np.round(np.log2(np.where(usable, sizes, 1.0)))
    return np.where(np.abs(exponents) <= ordinary, 1.0, 2.0**exponents)


@dataclass(frozen=True)
class Scale:
    """Divisors of a program's variables (n,), constraints (m,) and cost for a solver."""

    x: np.ndarray
    g: np.ndarray
    f: float = 1.0

    @classmethod
    def none(cls, n: int, m: int, f: float = 1.0) -> Scale:
        """Return the scale that only divides the cost, by ``f``."""
        return cls(np.ones(n), np.ones(m), f)

    @property
    def digest(self) -> str:
        """Digest of the divisors, equal for equal scales alone."""
        return sha256(
            b"".join(np.asarray(each, dtype=float).tobytes() for each in (self.x, self.g, self.f))
        ).hexdigest()


Entries = Callable[[np.ndarray, np.ndarray], "tuple[float, sp.csr_matrix]"]
"""Function from variables and parameters to the cost and the entries of the constraint Jacobian in a fixed order."""


def measure_scale(x: np.ndarray, defined: np.ndarray, evaluate: Entries, p: np.ndarray, natural: np.ndarray) -> Scale:
    """Return the scale of a program from the units ``x`` of its variables; scales of rows and cost are measured.

    If equations hold in all units, ``J(x z, p) = g J(z, natural) / x`` row by row: ``natural`` are
    the parameters p in natural units, and z the variables. ``defined`` (m,) is the index of the variable
    that a row defines, -1 for none; its unit is that of the row. A row without a finite positive ratio
    has the unit 1.
    """
    # There are two passes, since rows with products of variables need units that the first pass finds.
    x, _, _ = _measure_pass(x, defined, evaluate, p, natural)
    x, g, cost = _measure_pass(x, defined, evaluate, p, natural)
    return Scale(x, g, cost if np.isfinite(cost) and cost > 0 else 1.0)


def _measure_pass(
    x: np.ndarray, defined: np.ndarray, evaluate: Entries, p: np.ndarray, natural: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    z = np.random.default_rng(0).uniform(0.5, 1.5, x.size)
    (f, jacobian), (f_natural, natural_jacobian) = evaluate(x * z, p), evaluate(z, natural)
    entries, natural_entries = jacobian.tocoo(), natural_jacobian.tocoo()
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = entries.data * x[entries.col] / natural_entries.data
        cost = f / f_natural
    used = np.isfinite(ratio) & (ratio > 0) & (entries.col != defined[entries.row])
    x, g = x.copy(), _medians(entries.row[used], ratio[used], defined.size)
    defining = defined >= 0
    x[defined[defining]] = g[defining]
    return x, g, cost


def _medians(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the median of the values in each of ``count`` groups (the larger of two), 1 for an empty group."""
    order = np.lexsort((values, group))
    sizes = np.bincount(group, minlength=count)
    middle = np.cumsum(sizes) - sizes + sizes // 2
    medians, nonempty = np.ones(count), sizes > 0
    medians[nonempty] = values[order][middle[nonempty]]
    return medians


def row_scaled(x: np.ndarray, evaluate: Entries, p: np.ndarray, cost: float, largest: float = np.inf) -> Scale | None:
    """Return the scale of a program whose variables have the units ``x`` (n,); None if all scales are 1.

    A row's unit is the power of two nearest to its largest change as one variable changes by its unit,
    at most ``largest``, and 1 if this change is of ordinary size, so that a solver treats a constraint
    in the same way for any unit.
    """
    g = np.minimum(row_units(x, evaluate, p), largest)
    ones = np.all(x == 1) and np.all(g == 1) and cost == 1
    return None if ones else Scale(x, g, cost)


def row_units(x: np.ndarray, evaluate: Entries, p: np.ndarray) -> np.ndarray:
    """Return the units of the rows (m,), see :func:`row_scaled`, measured at a random point around ``x``."""
    _, jacobian = evaluate(x * np.random.default_rng(0).uniform(0.5, 1.5, x.size), p)
    changes = abs(jacobian).multiply(x[None, :]).max(axis=1)
    return solver_unit(changes.toarray().ravel(), ORDINARY_ROWS)
