"""The contact solve of a chunk of samples by kernels, samples along the last axis."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.batch.engines.chunk_network import Kernel
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.contact.path import ARRIVED

Array = np.ndarray


class ChunkSolver:
    """Multipliers of one step, branch by branch; the same loops as those of the C text."""

    def __init__(self, loop: InnerLoop, make: Callable[[ca.Function], Kernel]) -> None:
        self.loop = loop
        self._kernels = {name: make(graph) for name, graph in loop.graphs().items()}

    def __call__(self, arguments: list[Array], before: Array | None) -> Array:
        """Multipliers (branches * n, m) [N s]; `before` are those of the step before, if any."""
        loop, m = self.loop, arguments[0].shape[-1]
        lam, data = (np.empty((loop.branches * size, m)) for size in (loop.n, loop.n_data))
        self._kernels["opening"].run(arguments, [lam, data])
        for branch in range(loop.branches):
            rows = slice(branch * loop.n, (branch + 1) * loop.n)
            given = data[branch * loop.n_data :][: loop.n_data]
            if loop.newton:
                lam[rows] = self._by_newton(lam[rows], given)
            else:
                lam[rows] = self._from_starts(given, None if before is None else before[rows])
        return lam

    def _run(self, name: str, size: int, *inputs: Array) -> Array:
        found = np.empty((size, inputs[-1].shape[-1]))
        self._kernels[name].run(list(inputs), [found])
        return found

    def _by_newton(self, lam: Array, data: Array) -> Array:
        loop, still = self.loop, np.arange(lam.shape[-1])
        for _ in range(loop.newton_iterations):
            moved, unrest = np.empty((loop.n, len(still))), np.empty((1, len(still)))
            self._kernels["newton"].run([lam[:, still], data[:, still]], [moved, unrest])
            lam[:, still] = moved
            still = still[unrest[0] != 0.0]
            if not len(still):
                break
        end = self._run("settled", loop.n, lam, data)
        if len(still):
            rest = np.ascontiguousarray(data[:, still])
            pair = self._follow(np.ones((loop.n_pair, len(still))), rest, loop.most)
            end[:, still] = self._run("followed", loop.n, pair, rest)
        return end

    def _from_starts(self, data: Array, before: Array | None) -> Array:
        loop = self.loop
        if before is None:
            pair = self._follow(np.ones((loop.n_pair, data.shape[-1])), data, loop.most)
        else:
            pair = self._run("warm", loop.n_pair, before, data)
            pair = self._follow(pair, data, loop.most_warm)
        end = self._run("followed", loop.n, pair, data)
        end[:, pair[-1] != ARRIVED] = np.inf
        sound = np.isfinite(data.sum(axis=0))
        still = np.flatnonzero(sound & ~np.isfinite(end.sum(axis=0)))
        for k in range(loop.starts):
            if not len(still):
                break
            rest = np.ascontiguousarray(data[:, still])
            pair = self._run("further", loop.n_pair, np.full((1, len(still)), float(k)), rest)
            found = self._run("followed", loop.n, self._follow(pair, rest, loop.most_further), rest)
            solved = np.isfinite(found.sum(axis=0))
            end[:, still[solved]] = found[:, solved]
            still = still[~solved]
        return end

    def _follow(self, pair: Array, data: Array, most: int) -> Array:
        for _ in range(most):
            if not np.any(pair[-1] < ARRIVED):
                break
            pair = self._run("path", self.loop.n_pair, pair, data)
        return pair
