"""Values and derivatives of all steps of a horizon under a contact law, from one compiled function."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction
from dynamics.batch.engines.c_flat import CompiledEngine
from dynamics.contact import Step
from ocp.judge.constraint_rows import ConstraintRows
from ocp.problem.policy import OpenLoop
from ocp.problem.problem import Problem
from ocp.transcription.common import Graph

CLOSED_PAIR_COMPLIANCE = 1e-9
"""Compliance of closed pairs: gap divided by force, in characteristic sizes."""
MIN_PENALTY = 100.0
"""Minimum penalty of violated constraints in the merit, in characteristic costs per characteristic size."""


@dataclass
class Plan:
    """Trajectory over a horizon: states x (N+1, nx), inputs u (N, nu), multipliers lam and gaps (N, n)."""

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray

    @property
    def finite(self) -> bool:
        """Whether all states and inputs are finite."""
        return bool(np.isfinite(self.x).all() and np.isfinite(self.u).all())


class StageValues(NamedTuple):
    """Values and derivatives of a plan's steps, one row per step.

    The values are the ``residual`` (N, nx) of the step's equations, ``gap`` and ``mu`` (N, n), and the ``rows``
    (N, m) that constraints keep at 0 or above; the ``jacobian`` of all these in (x, u, x_next, lam); ``gradient``
    (N, nw) and ``hessian`` of the stage cost in w = (x, u_before, u), and in lam if it has any; ``end_gradient`` and
    ``end_hessian`` of the terminal cost in x_N.
    """

    residual: np.ndarray
    gap: np.ndarray
    mu: np.ndarray
    rows: np.ndarray
    jacobian: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    end_gradient: np.ndarray
    end_hessian: np.ndarray


class StageModel:
    """Model of a problem's step under a contact law, which evaluates all steps of a plan at once.

    Path constraints and bounds on x_next are inequality rows in characteristic sizes. ``distances`` evaluates signed
    distances and their derivatives by pair and state, None for a system without them.

    Raises the errors of :class:`~ocp.transcription.common.Graph`.
    """

    def __init__(self, problem: Problem, step: Step) -> None:
        self.problem, self.step = problem, step
        graph = Graph(problem, step, OpenLoop())
        self.nx, self.nu, self.n, self.N = graph.nx, graph.nu, step.n, problem.N
        self.names = graph.names
        self.of_step = [self.names.index(name) for name in step.p.names]
        self.of_problem = [self.names.index(name) for name in problem.parameters.names]
        system = problem.system
        constraints = ConstraintRows.of(problem)
        rows, self.violations = graph.with_impulses(constraints.expression), constraints.violations
        self.m = rows.numel()
        self._edges = [0, *accumulate((self.nx, self.n, self.n, self.m))]
        cost, w = graph.stage_cost(), ca.vertcat(system.x, graph.u_before, system.u)
        self.costs_impulses = bool(ca.depends_on(cost, step.lam))
        w = ca.vertcat(w, step.lam) if self.costs_impulses else w
        values = ca.vertcat(step.residual, step.gap, step.mu, rows)
        variables = ca.vertcat(system.x, system.u, system.x_next, step.lam)
        hessian, gradient = ca.hessian(cost, w)
        # Every step has the terminal cost of its next state, since one more call takes longer than these values.
        p_end = ca.SX.sym("p_end", graph.p.shape)
        terminal_cost = ca.substitute(problem.changeable_costs[1], system.x, system.x_next)
        terminal_cost = ca.substitute(terminal_cost, graph.p, p_end)
        end_hessian, end_gradient = ca.hessian(terminal_cost, system.x_next)
        arguments = [system.x, graph.u_before, system.u, system.x_next, step.lam, graph.p, p_end]
        self.distances = None
        if system.phi is not None and system.phi.numel():
            outputs = [system.phi, ca.jacobian(system.phi, system.x).T]
            self.distances = _batch_function("mpc_distances", [system.x, problem.parameters.vector], outputs)
        self._merit = _batch_function("mpc_merit", arguments, [cost, ca.fmax(-rows, 0), step.gap, terminal_cost])
        slopes = [ca.jacobian(values, variables), gradient, hessian, end_gradient, end_hessian]
        self._stage = _batch_function("mpc_stage", arguments, [values, *slopes])

    @property
    def backend(self) -> str:
        """Backend that evaluates the steps: ``c``, or ``numpy`` on a computer without a C compiler."""
        return self._stage.backend

    @property
    def compiled_merit(self) -> CompiledEngine | None:
        """Compiled function of (cost, violations, gap, terminal cost) of steps, or None without a C compiler."""
        return self._merit.compiled

    @property
    def compiled_stage(self) -> CompiledEngine | None:
        """Compiled function of a step's values and derivatives, or None without a C compiler."""
        return self._stage.compiled

    def merits(
        self,
        x: np.ndarray,
        u: np.ndarray,
        lam: np.ndarray,
        u_before: np.ndarray,
        p: np.ndarray,
        penalty: float = MIN_PENALTY,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the merits (S,) of S plans, the violations (S, N, m) of their rows, and their gaps (S, N, n).

        The merit is the cost plus ``penalty`` characteristic costs times the sum of the violations in
        characteristic sizes. ``p`` are parameters (N+1, np). N may be less than the problem's number of steps.
        """
        S, N = u.shape[:2]
        inputs_before = np.concatenate([np.broadcast_to(u_before, (S, 1, self.nu)), u[:, :-1]], axis=1)
        arguments = (x[:, :-1], inputs_before, u, x[:, 1:], lam, np.broadcast_to(p[:-1], (S, *p[:-1].shape)))
        outputs = self._merit(*(v.reshape(S * N, -1) for v in arguments), p[-1])
        cost, violations, gap, terminal_costs = (v.reshape(S, N, -1) for v in outputs)
        stage_merits = cost + penalty * self.problem.scales.cost * violations.sum(axis=2, keepdims=True)
        return stage_merits.sum(axis=(1, 2)) + terminal_costs[:, -1, 0], violations, gap

    def evaluate(self, plan: Plan, u_before: np.ndarray, p: np.ndarray) -> StageValues:
        """Return values and derivatives of a plan's steps at parameters ``p`` (N+1, np)."""
        inputs_before = np.concatenate([u_before[None], plan.u[:-1]])
        x, N = plan.x, len(plan.u)
        arguments = [x[:-1], inputs_before, plan.u, x[1:], plan.lam, p[:-1], p[-1:]]
        outputs = [np.empty((N, size)) for size in self._stage.output_sizes]
        if self._stage.compiled is None:
            self._stage(*arguments, out=outputs)
        else:
            self._stage.compiled.evaluate([np.ascontiguousarray(v) for v in arguments], outputs, N)
        values, jacobian, gradient, hessian, end_gradient, end_hessian = outputs
        edges = self._edges
        residual, gap, mu, rows = (values[:, a:b] for a, b in pairwise(edges))
        nw = gradient.shape[1]
        return StageValues(
            residual,
            gap,
            mu,
            rows,
            jacobian.reshape(N, -1, edges[-1]).transpose(0, 2, 1),
            gradient,
            hessian.reshape(N, nw, nw),
            end_gradient[-1],
            end_hessian[-1].reshape(self.nx, self.nx),
        )

    @cached_property
    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Characteristic sizes (n,) of multipliers and of gaps; for slip pairs the two sizes are exchanged."""
        scales, pairs = self.problem.scales, self.problem.system.pairs
        slips = np.array([p.kind in ("slip", "table") for p in pairs] * self.step.branches, bool)
        lam = np.where(slips, scales.gap, scales.impulse)
        return lam, np.where(slips, scales.impulse, scales.gap)

    @cached_property
    def compliance(self) -> np.ndarray:
        """Compliance (n,) of closed pairs, gap divided by force, which distributes loads over redundant contacts.

        The compliance is 1e-9 in characteristic sizes. For slip pairs it is 0, since friction forces determine
        the slip speed.
        """
        pairs = self.problem.system.pairs
        forces = np.array([pair.kind not in ("slip", "table") for pair in pairs], dtype=float)
        lam, gap = self.sizes
        return CLOSED_PAIR_COMPLIANCE * np.tile(forces, self.step.branches) * gap / lam


def _batch_function(name: str, arguments: list[ca.SX], outputs: list[ca.SX]) -> BatchFunction:
    function = ca.Function(name, arguments, [ca.densify(v) for v in outputs], {"cse": True})
    return BatchFunction(function, threads=1)
