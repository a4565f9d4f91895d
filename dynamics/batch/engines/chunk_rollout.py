"""Rollouts whose loops run in Python over chunks of samples: the NumPy and CasADi backends."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Self

import casadi as ca
import numpy as np

from dynamics.batch.engines.chunk_network import ChunkNetwork, Kernel
from dynamics.batch.engines.chunk_solver import ChunkSolver
from dynamics.batch.engines.scratch import Scratch
from dynamics.batch.graphs.asked import Asked
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.batch.graphs.step_graphs import RolloutTapes

Array = np.ndarray


class ChunkRollout:
    """Forward and adjoint sweep of one chunk of samples, samples along the last axis.

    `make` turns a CasADi function into a `Kernel`; each graph of `tapes` is one kernel.
    """

    def __init__(
        self,
        tapes: RolloutTapes,
        horizon: int,
        per_step: bool,
        make: Callable[[ca.Function], Kernel],
    ) -> None:
        self.tapes, self.horizon, self.per_step = tapes, horizon, per_step
        self.scratch = Scratch()
        self.adjoint, self.score = make(tapes.adjoint), make(tapes.score)
        self.terminal, self.terminal_adjoint = make(tapes.terminal), make(tapes.terminal_adjoint)
        self.network = None if tapes.layers is None else ChunkNetwork(tapes.layers, make)
        loop = tapes.forward
        if isinstance(loop, Asked):
            self.queries, self.closing = make(loop.queries), make(loop.closing)
        elif isinstance(loop, InnerLoop):
            self.solve = ChunkSolver(loop, make)
            self.closing = make(loop.closing)
        else:
            self.step = make(loop)

    def over(self, horizon: int) -> Self:
        """The same kernels over another horizon."""
        other = copy(self)
        other.horizon, other.scratch = horizon, Scratch()
        return other

    def forward(
        self,
        x0: Array,
        theta: Array,
        p: Array,
        w: Array,
        m: int,
        slopes: bool = True,
        along: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """States `(N + 1, nx, m)`, multipliers `(N, nlam, m)` and costs `(m,)`.

        They are lost at the next call. `x0` (nx, m), `theta` (N or 1, n_theta, m), `p` (np, m) and
        `w` (N, nu, m) may each have 1 in place of m, for one that all samples share. Without
        ``slopes`` no adjoint can follow. Every step starts at ``along`` (N + 1, nx, m), where
        given.
        """
        x = self.scratch.array("x", self.horizon + 1, self.tapes.nx, m)
        after = self.scratch.array("after", self.tapes.nx, m)
        lam = self.scratch.array("lam", self.horizon, self.tapes.nlam, m)
        cost, stage = self.scratch.array("costs", 2, 1, m)
        cost[...] = 0.0
        x[0] = x0
        if along is not None:
            x[...] = along
        for t in range(self.horizon):
            arguments = [x[t], self._theta(theta, x[t], p, t), w[t], p]
            results = [x[t + 1] if along is None else after, lam[t], stage]
            if isinstance(self.tapes.forward, Asked):
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
        """What the graphs of step t take for theta."""
        if self.network is not None:
            return self.network.actions(theta[0], x, p)
        return theta[t] if self.per_step else theta[0]

    def _evaluate(self, asked: Asked, arguments: list[Array], slopes: bool) -> Array:
        """Outputs of the model at every branch and, with ``slopes``, its Jacobians by columns."""
        m, n_in, model = arguments[0].shape[-1], asked.model.n_in, asked.model
        z = np.empty((asked.queries.numel_out(0), m))
        self.queries.run(arguments, [z])
        rows = np.ascontiguousarray(z.reshape(-1, n_in, m).transpose(0, 2, 1).reshape(-1, n_in))
        found = np.zeros((self.tapes.nlam, m))
        branches = len(z) // n_in
        y, by_z = model.jacobians(rows) if slopes else (model.values(rows), None)
        parts = [y, *([] if by_z is None else [by_z.transpose(0, 2, 1).reshape(len(y), -1)])]
        at = 0
        for part in parts:
            columns = part.reshape(branches, m, -1).transpose(0, 2, 1).reshape(-1, m)
            found[at : at + len(columns)] = columns
            at += len(columns)
        return found

    def backward(
        self,
        x: Array,
        lam: Array,
        theta: Array,
        p: Array,
        w: Array,
        gradient: Array,
        pull: Array | None = None,
    ) -> None:
        """Fill `gradient` (N or 1, n_theta, m) with the derivative of the cost by theta.

        ``pull`` (nx, m) is added to its derivative by what is carried at the end.
        """
        m = x.shape[-1]
        xbar, before = self.scratch.array("bars", 2, self.tapes.nx, m)
        part = self.scratch.array("part", self.tapes.n_theta, m)
        if not self.per_step:
            gradient[...] = 0.0
        self.terminal_adjoint.run([x[-1], p], [xbar])
        if pull is not None:
            xbar += pull
        for t in reversed(range(self.horizon)):
            arguments = [x[t], self._theta(theta, x[t], p, t), w[t], p, lam[t], xbar]
            self.adjoint.run(arguments, [before, gradient[t] if self.per_step else part])
            if self.network is not None:
                before += self.network.pulled_back(theta[0], x[t], p, part, gradient[0])
            elif not self.per_step:
                gradient[0] += part
            xbar, before = before, xbar

    def scores(self, x: Array, theta: Array, p: Array, w: Array, score: Array) -> None:
        """Fill `score` (N or 1, n_theta, m) with the sum over steps of D_theta law' w."""
        part = np.empty((self.tapes.n_theta, x.shape[-1]))
        score[...] = 0.0
        for t in range(self.horizon):
            self.score.run([x[t], self._theta(theta, x[t], p, t), w[t]], [part])
            if self.network is not None:
                self.network.pulled_back(theta[0], x[t], p, part, score[0])
            else:
                score[t if self.per_step else 0] += part
