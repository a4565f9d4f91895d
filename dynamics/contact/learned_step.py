"""A learned model of a step as a CasADi function, and the step defined by this model, without multipliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np

from dynamics.contact.step import Step
from dynamics.systems import Signal

Shapes = Sequence[tuple[int, int]]
_CACHE_SIZE = 4096
"""Maximum number of queries in the cache of values and Jacobians; a solver evaluates cost, constraints and
derivatives at the same point one after the other."""


class LearnedMap(Protocol):
    """Interface of a model ``y = g(z)``, z = (x, u) (n_in,), y (n_out,) the next state and any further outputs.

    All arrays are float64 in physical units, with one row per query.
    """

    @property
    def n_in(self) -> int:
        """Number of entries of z."""
        ...

    @property
    def n_out(self) -> int:
        """Number of entries of y."""
        ...

    def values(self, z: np.ndarray) -> np.ndarray:
        """Return ``y`` (n, n_out) at ``z`` (n, n_in)."""
        ...

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``y`` (n, n_out) and ``dy/dz`` (n, n_out, n_in) at ``z`` (n, n_in)."""
        ...

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return ``sum_i weights_i d²y_i/dz²`` (n, n_in, n_in), symmetric, for ``weights`` (n, n_out)."""
        ...


class CasadiMap:
    """A :class:`LearnedMap` ``y = g(z)`` as CasADi functions, with a cache for values and Jacobians.

    Each function takes n queries as the columns of ``z`` (n_in, n) and evaluates them in one call.
    """

    def __init__(self, model: LearnedMap) -> None:
        self.model, self.n_in, self.n_out = model, model.n_in, model.n_out
        self._cache: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._functions: dict[tuple[str, int], ca.Callback] = {}

    def jacobian_function(self, n: int) -> ca.Function:
        """Return the function ``z (n_in, n) -> y (n_out, n), [g'(z_1) .. g'(z_n)] (n_out, n_in n)``."""

        def evaluate(z: np.ndarray) -> list[np.ndarray]:
            y, jacobians = self.model_outputs(z)
            return [y.T, _side_by_side(jacobians)]

        output_shapes = (self.n_out, n), (self.n_out, self.n_in * n)
        return self._function("jacobians", [(self.n_in, n)], output_shapes, evaluate)

    def curvature_function(self, n: int) -> ca.Function:
        """Return the function ``z (n_in, n), weights (n_out, n) -> [H_1 .. H_n] (n_in, n_in n)``.

        H is the second derivative of ``weights' g``."""
        input_shapes = (self.n_in, n), (self.n_out, n)
        return self._function(
            "curvatures",
            input_shapes,
            [(self.n_in, self.n_in * n)],
            lambda z, weights: [_side_by_side(self.model.curvatures(z, weights))],
        )

    def values(self) -> ca.Function:
        """Return the function ``z (n_in, 1) -> y (n_out, 1)``, which CasADi can differentiate twice."""
        n_in, n_out = self.n_in, self.n_out

        def tensor(z: np.ndarray) -> list[np.ndarray]:
            """Return ``d vec(J) / dz`` (n_out n_in, n_in), where vec(J) stacks the columns of J."""
            second = self.model.curvatures(np.repeat(z, n_out, axis=0), np.eye(n_out))
            return [second.transpose(1, 0, 2).reshape(n_out * n_in, n_in)]

        z = [(n_in, 1)]
        second = self._function("tensor", z, [(n_out * n_in, n_in)], tensor)
        first = self._function("jacobian", z, [(n_out, n_in)], lambda z: [self.model_outputs(z)[1][0]], second)
        return self._function("values", z, [(n_out, 1)], lambda z: [self.model_outputs(z)[0].T], first)

    def _function(self, name: str, input_shapes: Shapes, *arguments: Any) -> ca.Function:
        # CasADi does not own a reference to a callback; without this table it would be garbage-collected.
        key = name, input_shapes[0][1]
        if key not in self._functions:
            self._functions[key] = _Callback(name, input_shapes, *arguments)
        return self._functions[key]

    def model_outputs(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``y`` (n, n_out) and Jacobians (n, n_out, n_in) at ``z`` (n, n_in), from the cache if possible."""
        keys = [row.tobytes() for row in z]
        missing = [i for i, key in enumerate(keys) if key not in self._cache]
        if len(self._cache) + len(missing) > _CACHE_SIZE:
            self._cache.clear()
            missing = list(range(len(z)))
        if missing:
            new_pairs = self.model.jacobians(z[missing])
            self._cache |= {keys[i]: pair for i, pair in zip(missing, zip(*new_pairs, strict=True), strict=True)}
        pairs = [self._cache[key] for key in keys]
        return np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])


def _side_by_side(blocks: np.ndarray) -> np.ndarray:
    """Return blocks (n, rows, columns) side by side as a matrix (rows, n columns)."""
    return blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)


class _Callback(ca.Callback):
    """CasADi callback that calls ``compute`` with the transposed arguments, one row per query.

    ``input_shapes`` and ``output_shapes`` are the shapes of arguments and results; ``derivative`` is the
    Jacobian function of a callback with one argument and one result, or None if it is not needed.
    """

    def __init__(
        self,
        name: str,
        input_shapes: Shapes,
        output_shapes: Shapes,
        compute: Callable[..., list[np.ndarray]],
        derivative: ca.Function | None = None,
    ) -> None:
        super().__init__()
        self.input_shapes, self.output_shapes, self.compute, self.derivative = (
            input_shapes,
            output_shapes,
            compute,
            derivative,
        )
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.input_shapes)

    def get_n_out(self) -> int:
        return len(self.output_shapes)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.input_shapes[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.output_shapes[i])

    def eval(self, arg: Any) -> list[Any]:
        rows = (np.ascontiguousarray(np.array(ca.densify(value)).T) for value in arg)
        return [ca.DM(result) for result in self.compute(*rows)]

    def has_jacobian(self) -> bool:
        return self.derivative is not None

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        z, y = ca.MX.sym("z", *self.input_shapes[0]), ca.MX.sym("y", *self.output_shapes[0])
        assert self.derivative is not None
        return ca.Function(name, [z, y], [self.derivative(z)], inames, onames, opts)


@dataclass(frozen=True, eq=False)
class LearnedStep(Step):
    """Time step ``x_next = sum_b w_b g(x + noise_b, u + noise_b)`` of a model g; without noise there is one branch.

    ``inner`` are the model's outputs at the ``queries``, branch after branch; a model may have further
    outputs after the next state (the log-density of the data). There are no multipliers: ``lam``,
    ``gap`` and ``mu`` have no entries. ``trust`` is the weight beta of ``-beta log p`` in the stage
    cost, None if the law does not have this term.
    """

    learned: CasadiMap
    trust: ca.SX | None = None

    @property
    def lam(self) -> ca.SX:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Symbols of contact multipliers (0, 1): a learned step has no multipliers, gaps or mu."""
        return ca.SX(0, 1)

    gap_expr = gap = mu = lam  # pyright: ignore[reportAssignmentType]

    @cached_property
    def contacts(self) -> tuple[Signal, ...]:
        """Names of the multipliers, empty for a learned step."""
        return ()

    @cached_property
    def inner(self) -> ca.SX:
        """Symbols of the model's outputs (B n_out, 1)."""
        return ca.SX.sym("y", self.branches * self.learned.n_out)

    @cached_property
    def jacobians(self) -> list[ca.SX]:
        """Symbols of the model's Jacobian (n_out, n_in) at each branch."""
        shape = self.learned.n_out, self.learned.n_in
        return [ca.SX.sym(f"jacobian_{b}", *shape) for b in range(self.branches)]

    @cached_property
    def model_outputs(self) -> ca.SX:
        """Symbols of the model's outputs and Jacobians: ``inner``, followed by the columns of ``jacobians``."""
        return ca.vertcat(self.inner, *(ca.vec(jacobian) for jacobian in self.jacobians))

    def query_gradient(self, value: ca.SX) -> ca.SX:
        """Return the derivative (B n_in, 1) of a scalar that depends on the queries through ``inner``."""
        output_gradients = ca.vertsplit(ca.densify(ca.gradient(value, self.inner)), self.learned.n_out)
        return ca.vertcat(*(J.T @ gradient for J, gradient in zip(self.jacobians, output_gradients, strict=True)))

    @cached_property
    def queries(self) -> ca.SX:
        """Points (B n_in, 1) at which the model is evaluated, an expression in (x, u, p)."""
        z = ca.vertcat(self.system.x, self.system.u)
        return ca.vertcat(*(z + ca.vertcat(b.noise_x, b.noise_u) for b in self.nodes))

    @cached_property
    def _outputs(self) -> list[ca.SX]:
        return ca.vertsplit(self.inner, self.learned.n_out)

    @cached_property
    def x_next_expr(self) -> ca.SX:
        """Weighted mean of the branches' next states (nx, 1)."""
        branch_outputs = zip(self.nodes, self._outputs, strict=True)
        return sum((node.weight * y[: self.system.nx] for node, y in branch_outputs), ca.SX(self.system.nx, 1))

    @property
    def extra_stage_cost(self) -> ca.SX:
        """Stage cost ``-beta log p_sigma(x, u)`` of the law, averaged over the branches; p is the data's density."""
        if self.trust is None:
            return ca.SX(0)
        branch_outputs = zip(self.nodes, self._outputs, strict=True)
        return -self.trust * sum((node.weight * y[-1] for node, y in branch_outputs), ca.SX(0))

    @cached_property
    def residual(self) -> ca.SX:
        """Residual ``x_next - x_next_expr`` (nx, 1), an expression in (x_next, inner)."""
        return self.system.x_next - self.x_next_expr

    def solution(self, x: ca.MX, u: ca.MX, p: ca.MX) -> tuple[ca.MX, ...]:
        """Return ``inner, x_next, lam, gap, error``, the last three without entries."""
        query_points = ca.Function("queries", self.inputs, [ca.densify(self.queries)])(x, u, p)
        value = self.learned.values()
        inner = ca.vertcat(*(value(z) for z in ca.vertsplit(query_points, self.learned.n_in)))
        x_next = ca.Function("x_next_expr", [self.inner], [ca.densify(self.x_next_expr)])(inner)
        no_contact = ca.MX(0, 1)
        return inner, x_next, no_contact, no_contact, no_contact

    @cached_property
    def relation(self) -> ca.Function:
        """Function from ``(x, u, x_next, lam, p)`` to the residual of x_next, with empty gap and mu."""
        x, u, p = self._symbols()
        x_next, lam, no_contact = ca.MX.sym("x_next", self.system.nx), ca.MX.sym("lam", 0), ca.MX(0, 1)
        names = ["x", "u", "x_next", "lam", "p"], ["residual", "gap", "mu"]
        residual = x_next - self.solution(x, u, p)[1]
        return ca.Function("relation", [x, u, x_next, lam, p], [residual, no_contact, no_contact], *names)

    @cached_property
    def map(self) -> ca.Function:
        """Explicit step ``(x, u, p) -> (x_next, lam)``, differentiable to second order, with empty lam."""
        x, u, p = self._symbols()
        _, x_next, lam, _, _ = self.solution(x, u, p)
        return ca.Function("step", [x, u, p], [x_next, lam], ["x", "u", "p"], ["x_next", "lam"])
