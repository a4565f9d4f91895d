"""What a complementarity problem is: expressions, bounds and names, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.errors import InputError


@dataclass(frozen=True, eq=False)
class MPCC:
    """``min f(x, p)`` subject to ``lbg <= g(x, p) <= ubg``, ``lbx <= x <= ubx`` and
    ``0 <= G(x, p) ⟂ H(x, p) >= 0``.

    x (n, 1), p (n_p, 1) are symbols, f (1, 1), g (m, 1), G and H (k, 1) expressions in them. Bounds
    are numbers or sequences; without ``lbg``, ``ubg`` g is an equation. ``names`` (k) name the
    pairs in verdicts.

    Raises :class:`~ocp.errors.InputError` where sizes do not fit, bounds cross, a symbol is not
    declared, or a pair is the same expression twice.
    """

    x: ca.SX
    f: ca.SX
    G: ca.SX
    H: ca.SX
    g: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    p: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    lbx: float | Sequence[float] | np.ndarray = -np.inf
    ubx: float | Sequence[float] | np.ndarray = np.inf
    lbg: float | Sequence[float] | np.ndarray = 0.0
    ubg: float | Sequence[float] | np.ndarray = 0.0
    names: Sequence[str] = ()
    name: str = "mpcc"

    def __post_init__(self) -> None:
        for what, value in (("f", self.f), ("g", self.g), ("G", self.G), ("H", self.H)):
            object.__setattr__(self, what, ca.densify(ca.SX(value)))
        self._check_sizes()
        for what, lower, upper in (("x", *self.x_bounds), ("g", *self.g_bounds)):
            crossed = np.flatnonzero(~(lower <= upper))
            if crossed.size:
                i = int(crossed[0])
                raise InputError(
                    f"{self.name}: the bounds of {what}[{i}] cross: {lower[i]:g} > {upper[i]:g};"
                    " exchange or widen them"
                )
        for i in range(self.G.numel()):
            if ca.is_equal(self.G[i], self.H[i], 2):
                raise InputError(
                    f"{self.name}: pair {self.pair(i)!r} is the same expression twice,"
                    f" {self.G[i]}; a pair needs two sides"
                )

    def _check_sizes(self) -> None:
        if self.f.numel() != 1:
            raise InputError(f"{self.name}: f has {self.f.numel()} entries, expected 1")
        if self.G.numel() != self.H.numel():
            raise InputError(
                f"{self.name}: G has {self.G.numel()} entries and H {self.H.numel()}; expected as"
                " many of both"
            )
        if self.names and len(self.names) != self.G.numel():
            raise InputError(
                f"{self.name}: {len(self.names)} names for {self.G.numel()} pairs; give one each"
            )
        known = {str(symbol) for symbol in ca.symvar(ca.vertcat(self.x, self.p))}
        used = ca.symvar(ca.vertcat(self.f, self.g, self.G, self.H))
        strange = sorted({str(symbol) for symbol in used} - known)
        if strange:
            raise InputError(f"{self.name}: {', '.join(strange)} is neither in x nor in p")

    def pair(self, index: int) -> str:
        """Name of a pair."""
        return self.names[index] if self.names else f"pair {index}"

    @property
    def x_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, (n,) each."""
        n = self.x.numel()
        return sized(self.name, "lbx", self.lbx, n), sized(self.name, "ubx", self.ubx, n)

    @property
    def g_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of g, (m,) each."""
        m = self.g.numel()
        return sized(self.name, "lbg", self.lbg, m), sized(self.name, "ubg", self.ubg, m)


def sized(name: str, what: str, value: float | Sequence[float] | np.ndarray, n: int) -> np.ndarray:
    """Numbers as a vector (n,), one number repeated; an :class:`InputError` for other sizes."""
    numbers = np.asarray(value, dtype=float).ravel()
    if numbers.size not in (1, n):
        raise InputError(f"{name}: {what} has {numbers.size} entries, expected {n}")
    return np.broadcast_to(numbers, n).copy()
