"""A model of a step as CasADi functions: values, Jacobians and second derivatives, all at once."""

from __future__ import annotations

from typing import Any, Protocol

import casadi as ca
import numpy as np

_KEPT = 4096
"""Queries whose values and Jacobians are kept: a solver asks for cost, constraints and their
derivatives one after the other at the same point."""


class LearnedMap(Protocol):
    """``y = g(z)``, z = (x, u) (n_in,), y (n_out,) the next state and, after it, whatever else.

    Everything is in physical units and float64, one row a query.
    """

    @property
    def n_in(self) -> int:
        """Entries of z."""
        ...

    @property
    def n_out(self) -> int:
        """Entries of y."""
        ...

    def values(self, z: np.ndarray) -> np.ndarray:
        """``y`` (n, n_out) at ``z`` (n, n_in)."""
        ...

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``y`` (n, n_out) and ``dy/dz`` (n, n_out, n_in)."""
        ...

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """``sum_i weights_i d²y_i/dz²`` (n, n_in, n_in), symmetric, for ``weights`` (n, n_out)."""
        ...


class CasadiMap:
    """``y = g(z)`` of a :class:`LearnedMap` for CasADi's graphs.

    Each function takes n queries as the columns of ``z`` (n_in, n) and evaluates them in one call.
    """

    def __init__(self, model: LearnedMap) -> None:
        self.model, self.n_in, self.n_out = model, model.n_in, model.n_out
        self._known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._made: dict[tuple[str, int], ca.Callback] = {}

    def slopes(self, n: int) -> ca.Function:
        """``z (n_in, n) -> y (n_out, n), [g'(z_1) .. g'(z_n)] (n_out, n_in n)``."""
        return self._function("slopes", n, lambda: _Slopes(self, n))

    def bends(self, n: int) -> ca.Function:
        """``z (n_in, n), weights (n_out, n) -> [H_1 .. H_n] (n_in, n_in n)``, H the second
        derivative of ``weights' g``.
        """
        return self._function("bends", n, lambda: _Bends(self, n))

    def values(self) -> ca.Function:
        """``z (n_in, 1) -> y (n_out, 1)``, which CasADi can differentiate twice."""
        return self._function("values", 1, lambda: _Values(self))

    def _function(self, kind: str, n: int, make: Any) -> ca.Function:
        # CasADi holds no reference to a callback: without this table it would be collected.
        if (kind, n) not in self._made:
            self._made[kind, n] = make()
        return self._made[kind, n]

    def evaluated(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``y`` (n, n_out) and Jacobians (n, n_out, n_in) at ``z`` (n, n_in)."""
        keys = [row.tobytes() for row in z]
        new = [i for i, key in enumerate(keys) if key not in self._known]
        if len(self._known) + len(new) > _KEPT:
            self._known.clear()
            new = list(range(len(z)))
        if new:
            found = self.model.jacobians(z[new])
            self._known |= {keys[i]: pair for i, pair in zip(new, zip(*found, strict=True),
                                                             strict=True)}  # fmt: skip
        pairs = [self._known[key] for key in keys]
        return np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])


def _rows(z: ca.DM) -> np.ndarray:
    return np.ascontiguousarray(np.array(ca.densify(z)).T)


def _side_by_side(blocks: np.ndarray) -> np.ndarray:
    """Blocks (n, rows, columns) beside each other, (rows, n columns)."""
    return blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)


class _Callback(ca.Callback):
    """A function of the queries' matrix; ``shapes`` are those of arguments and results."""

    def __init__(
        self, owner: CasadiMap, name: str, given: list[tuple[int, int]],
        made: list[tuple[int, int]],
    ) -> None:  # fmt: skip
        super().__init__()
        self.owner, self.given, self.made = owner, given, made
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.given)

    def get_n_out(self) -> int:
        return len(self.made)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.given[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.made[i])


class _Slopes(_Callback):
    def __init__(self, owner: CasadiMap, n: int) -> None:
        results = [(owner.n_out, n), (owner.n_out, owner.n_in * n)]
        super().__init__(owner, "slopes", [(owner.n_in, n)], results)

    def eval(self, arg: Any) -> list[Any]:
        y, slopes = self.owner.evaluated(_rows(arg[0]))
        return [ca.DM(y.T), ca.DM(_side_by_side(slopes))]


class _Bends(_Callback):
    def __init__(self, owner: CasadiMap, n: int) -> None:
        given = [(owner.n_in, n), (owner.n_out, n)]
        super().__init__(owner, "bends", given, [(owner.n_in, owner.n_in * n)])

    def eval(self, arg: Any) -> list[Any]:
        bends = self.owner.model.curvatures(_rows(arg[0]), _rows(arg[1]))
        return [ca.DM(_side_by_side(bends))]


class _Values(_Callback):
    def __init__(self, owner: CasadiMap) -> None:
        super().__init__(owner, "values", [(owner.n_in, 1)], [(owner.n_out, 1)])

    def eval(self, arg: Any) -> list[Any]:
        return [ca.DM(self.owner.evaluated(_rows(arg[0]))[0].T)]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        z, y = ca.MX.sym("z", self.owner.n_in), ca.MX.sym("y", self.owner.n_out)
        self.slope = _Jacobian(self.owner)
        return ca.Function(name, [z, y], [self.slope(z)], inames, onames, opts)


class _Jacobian(_Callback):
    def __init__(self, owner: CasadiMap) -> None:
        super().__init__(owner, "jacobian", [(owner.n_in, 1)], [(owner.n_out, owner.n_in)])

    def eval(self, arg: Any) -> list[Any]:
        return [ca.DM(self.owner.evaluated(_rows(arg[0]))[1][0])]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        z, J = ca.MX.sym("z", self.owner.n_in), ca.MX.sym("J", self.owner.n_out, self.owner.n_in)
        self.curve = _Tensor(self.owner)
        return ca.Function(name, [z, J], [self.curve(z)], inames, onames, opts)


class _Tensor(_Callback):
    """d vec(J) / dz, (n_out n_in, n_in), columns of J one after the other."""

    def __init__(self, owner: CasadiMap) -> None:
        n_in, n_out = owner.n_in, owner.n_out
        super().__init__(owner, "tensor", [(n_in, 1)], [(n_out * n_in, n_in)])

    def eval(self, arg: Any) -> list[Any]:
        n_in, n_out = self.owner.n_in, self.owner.n_out
        z = np.repeat(_rows(arg[0]), n_out, axis=0)
        second = self.owner.model.curvatures(z, np.eye(n_out))
        return [ca.DM(second.transpose(1, 0, 2).reshape(n_out * n_in, n_in))]
