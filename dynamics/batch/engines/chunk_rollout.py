"""Rollouts with loops in Python over chunks of samples, for the NumPy and CasADi backends."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.batch.engines.kernels import Kernel
from dynamics.batch.engines.parallel import Scratch
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.batch.graphs.step_graphs import Layers, ModelStepGraphs, RolloutTapes, layer_slices
from dynamics.contact.path import ARRIVED

Array = np.ndarray

PYTHON_CHUNK = 4096
"""Number of samples in a chunk where loops run in Python and graphs are long."""


class ChunkSolver:
    """Solver for the contact multipliers of one step, one branch after another, with the same loops as the C code."""

    def __init__(self, loop: InnerLoop, make: Callable[[ca.Function], Kernel]) -> None:
        self.loop = loop
        self._kernels = {name: make(graph) for name, graph in loop.graphs().items()}

    def __call__(self, arguments: list[Array], lam_before: Array | None) -> Array:
        """Return the multipliers (branches * n, m) [N s]; `lam_before` are those of the previous step, if any."""
        loop, m = self.loop, arguments[0].shape[-1]
        lam, data = (np.empty((loop.branches * size, m)) for size in (loop.n, loop.n_data))
        self._kernels["opening"].run(arguments, [lam, data])
        for branch in range(loop.branches):
            rows = slice(branch * loop.n, (branch + 1) * loop.n)
            branch_data = data[branch * loop.n_data :][: loop.n_data]
            if loop.newton:
                lam[rows] = self._by_newton(lam[rows], branch_data)
            else:
                lam[rows] = self._from_starts(branch_data, None if lam_before is None else lam_before[rows])
        return lam

    def _run(self, name: str, size: int, *inputs: Array) -> Array:
        output = np.empty((size, inputs[-1].shape[-1]))
        self._kernels[name].run(list(inputs), [output])
        return output

    def _by_newton(self, lam: Array, data: Array) -> Array:
        loop, active = self.loop, np.arange(lam.shape[-1])
        for _ in range(loop.newton_iterations):
            new_lam, unrest = np.empty((loop.n, len(active))), np.empty((1, len(active)))
            self._kernels["newton"].run([lam[:, active], data[:, active]], [new_lam, unrest])
            lam[:, active] = new_lam
            active = active[unrest[0] != 0.0]
            if not len(active):
                break
        solution = self._run("newton_solution", loop.n, lam, data)
        if len(active):
            active_data = np.ascontiguousarray(data[:, active])
            pair = self._follow(np.ones((loop.n_pair, len(active))), active_data, loop.max_iterations)
            solution[:, active] = self._run("path_solution", loop.n, pair, active_data)
        return solution

    def _from_starts(self, data: Array, lam_before: Array | None) -> Array:
        loop = self.loop
        if lam_before is None:
            pair = np.ones((loop.n_pair, data.shape[-1]))
        else:
            pair = self._run("warm", loop.n_pair, lam_before, data)
        pair = self._follow(pair, data, loop.max_iterations)
        solution = self._run("path_solution", loop.n, pair, data)
        solution[:, pair[-1] != ARRIVED] = np.inf
        has_finite_data = np.isfinite(data.sum(axis=0))
        active = np.flatnonzero(has_finite_data & ~np.isfinite(solution.sum(axis=0)))
        for k in range(loop.starts):
            if not len(active):
                break
            active_data = np.ascontiguousarray(data[:, active])
            pair = self._run("other_start", loop.n_pair, np.full((1, len(active)), float(k)), active_data)
            candidate = self._run(
                "path_solution", loop.n, self._follow(pair, active_data, loop.max_other_iterations), active_data
            )
            solved = np.isfinite(candidate.sum(axis=0))
            solution[:, active[solved]] = candidate[:, solved]
            active = active[~solved]
        return solution

    def _follow(self, pair: Array, data: Array, max_iterations: int) -> Array:
        for _ in range(max_iterations):
            if not np.any(pair[-1] < ARRIVED):
                break
            pair = self._run("path", self.loop.n_pair, pair, data)
        return pair


class ChunkNetwork:
    """Dense network from the observation of a state to the mean action `a = W_L tanh(...) + b_L`, samples last.

    theta is (n_weights, m), or (n_weights, 1) if all samples share it.
    """

    def __init__(
        self, layers: Layers, observe_adjoint: ca.Function | None, make: Callable[[ca.Function], Kernel]
    ) -> None:
        self._layers, self._slices = layers, layer_slices(layers.sizes)
        self._observe = make(layers.observe)
        self._back = None if observe_adjoint is None else make(observe_adjoint)

    def mean_actions(self, theta: Array, x: Array, p: Array) -> Array:
        """Return the mean actions (n_a, m) at states x (nx, m)."""
        return self._values(theta, x, p)[-1]

    def backpropagate(self, theta: Array, x: Array, p: Array, abar: Array, total: Array) -> Array:
        """Add `D_theta a' abar` to `total` (n_weights, m), and return `D_x a' abar` (nx, m)."""
        values, adjoint = self._values(theta, x, p), abar
        for k, (weights, offsets, shape) in reversed(list(enumerate(self._slices))):
            product = adjoint[:, None] * values[k][None]
            total[weights] += product.reshape(-1, product.shape[-1])
            total[offsets] += adjoint
            adjoint = _weighted_sums(theta[weights].reshape(*shape, -1), adjoint, (0, 2))
            if k:
                adjoint *= 1.0 - values[k] ** 2
        xbar = np.empty_like(x)
        assert self._back is not None
        self._back.run([x, p, adjoint], [xbar])
        return xbar

    def _values(self, theta: Array, x: Array, p: Array) -> list[Array]:
        """Return the activations (size, m) of observation, hidden layers and mean action, in order."""
        observation = np.empty((self._layers.sizes[0], x.shape[-1]))
        self._observe.run([x, p], [observation])
        values = [observation]
        for weights, offsets, shape in self._slices:
            if len(values) > 1:
                np.tanh(values[-1], out=values[-1])
            matrix = theta[weights].reshape(*shape, -1)
            values.append(_weighted_sums(matrix, values[-1], (1, 2)) + theta[offsets])
        return values


def _weighted_sums(weights: Array, values: Array, axes: tuple[int, int]) -> Array:
    """Return `sum_i w_oi v_i`, or with axes (0, 2) `sum_o w_oi v_o`, for each sample m."""
    summed_axis = axes[0]
    if weights.shape[-1] == 1:
        matrix = weights[..., 0] if summed_axis == 1 else weights[..., 0].T
        return matrix @ values
    return np.einsum("oim,im->om" if summed_axis == 1 else "oim,om->im", weights, values)


class ChunkRollout:
    """Forward and adjoint sweeps for one chunk of samples; samples are the last axis.

    `make` turns a CasADi function into a `Kernel`; each graph of `tapes` is one kernel. Tapes without adjoint allow
    only the forward sweep. The length of the noise
    is the horizon N; theta has one row for every step, or a single row that all steps share.
    """

    def __init__(self, tapes: RolloutTapes, make: Callable[[ca.Function], Kernel]) -> None:
        self.tapes, self.scratch = tapes, Scratch()
        self.terminal = make(tapes.terminal)
        adjoint, loop = tapes.adjoint, tapes.forward
        observe_adjoint = None
        if adjoint is not None:
            self.adjoint, self.score, self.terminal_adjoint = map(make, (adjoint.step, adjoint.score, adjoint.terminal))
            observe_adjoint = adjoint.observe
        self.network = None if tapes.layers is None else ChunkNetwork(tapes.layers, observe_adjoint, make)
        if isinstance(loop, ModelStepGraphs):
            self.queries, self.closing = make(loop.queries), make(loop.closing)
        elif isinstance(loop, InnerLoop):
            self.solve = ChunkSolver(loop, make)
            self.closing = make(loop.closing)
        else:
            self.step = make(loop)

    def forward(
        self,
        x0: Array,
        theta: Array,
        p: Array,
        w: Array,
        m: int,
        slopes: bool = True,
        linearise_along: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return states `(N + 1, nx, m)`, multipliers `(N, nlam, m)` and costs `(m,)`.

        The next call overwrites these arrays. `x0` (nx, m), `theta` (N or 1, n_theta, m), `p` (np, m) and `w`
        (N, nu, m) may each have 1 in place of m if all samples share them. ``slopes`` is needed for a later
        adjoint sweep. If ``linearise_along`` (N + 1, nx, m) is not None, step t starts at its entry t.
        """
        x = self.scratch.array("x", len(w) + 1, self.tapes.nx, m)
        x_next_unused = self.scratch.array("after", self.tapes.nx, m)
        lam = self.scratch.array("lam", len(w), self.tapes.nlam, m)
        cost, stage = self.scratch.array("costs", 2, 1, m)
        cost[...] = 0.0
        x[0] = x0
        if linearise_along is not None:
            x[...] = linearise_along
        for t in range(len(w)):
            arguments = [x[t], self._theta(theta, x[t], p, t), w[t], p]
            results = [x[t + 1] if linearise_along is None else x_next_unused, lam[t], stage]
            if isinstance(self.tapes.forward, ModelStepGraphs):
                evaluated = self._evaluate(self.tapes.forward, arguments, slopes)
                self.closing.run([*arguments, evaluated], results)
            elif isinstance(self.tapes.forward, InnerLoop):
                solved = self.solve(arguments, lam[t - 1] if t else None)
                self.closing.run([*arguments, solved], results)
            else:
                self.step.run(arguments, results)
            cost += stage
        self.terminal.run([x[-1], p], [stage])
        cost += stage
        return x, lam, cost[0]

    def _theta(self, theta: Array, x: Array, p: Array, t: int) -> Array:
        """Return theta of step t: the row of this step, the row shared by all steps, or the network's mean actions."""
        if self.network is not None:
            return self.network.mean_actions(theta[0], x, p)
        return theta[min(t, len(theta) - 1)]

    def _evaluate(self, graphs: ModelStepGraphs, arguments: list[Array], slopes: bool) -> Array:
        """Return the model's outputs at every branch and, with ``slopes``, its Jacobians column by column."""
        m, n_in, model = arguments[0].shape[-1], graphs.model.n_in, graphs.model
        z = np.empty((graphs.queries.numel_out(0), m))
        self.queries.run(arguments, [z])
        rows = np.ascontiguousarray(z.reshape(-1, n_in, m).transpose(0, 2, 1).reshape(-1, n_in))
        evaluated = np.zeros((self.tapes.nlam, m))
        branches = len(z) // n_in
        y, by_z = model.jacobians(rows) if slopes else (model.values(rows), None)
        model_outputs = [y, *([] if by_z is None else [by_z.transpose(0, 2, 1).reshape(len(y), -1)])]
        first_row = 0
        for model_output in model_outputs:
            columns = model_output.reshape(branches, m, -1).transpose(0, 2, 1).reshape(-1, m)
            evaluated[first_row : first_row + len(columns)] = columns
            first_row += len(columns)
        return evaluated

    def backward(
        self,
        x: Array,
        lam: Array,
        theta: Array,
        p: Array,
        w: Array,
        gradient: Array,
        terminal_gradient: Array | None = None,
    ) -> None:
        """Fill `gradient` (N or 1, n_theta, m) with the derivative of the cost with respect to theta.

        ``terminal_gradient`` (nx, m) is added to the derivative with respect to the last state.
        """
        m = x.shape[-1]
        xbar, xbar_before = self.scratch.array("bars", 2, self.tapes.nx, m)
        theta_bar = self.scratch.array("part", self.tapes.n_theta, m)
        per_step = len(gradient) > 1
        if not per_step:
            gradient[...] = 0.0
        self.terminal_adjoint.run([x[-1], p], [xbar])
        if terminal_gradient is not None:
            xbar += terminal_gradient
        for t in reversed(range(len(w))):
            arguments = [x[t], self._theta(theta, x[t], p, t), w[t], p, lam[t], xbar]
            self.adjoint.run(arguments, [xbar_before, gradient[t] if per_step else theta_bar])
            if self.network is not None:
                xbar_before += self.network.backpropagate(theta[0], x[t], p, theta_bar, gradient[0])
            elif not per_step:
                gradient[0] += theta_bar
            xbar, xbar_before = xbar_before, xbar

    def scores(self, x: Array, theta: Array, p: Array, w: Array, score: Array) -> None:
        """Fill `score` (N or 1, n_theta, m) with the sum over steps of D_theta law' w."""
        theta_bar = np.empty((self.tapes.n_theta, x.shape[-1]))
        score[...] = 0.0
        for t in range(len(w)):
            self.score.run([x[t], self._theta(theta, x[t], p, t), w[t]], [theta_bar])
            if self.network is not None:
                self.network.backpropagate(theta[0], x[t], p, theta_bar, score[0])
            else:
                score[min(t, len(score) - 1)] += theta_bar
