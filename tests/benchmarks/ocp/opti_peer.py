"""The peer: a plain Opti script, as users write contact problems today."""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.programs.solver import IPOPT_DEFAULTS
from tests.benchmarks.ocp.models import Model

SCHOLTES = [10.0**-i for i in range(9)]


@dataclass(frozen=True)
class Guess:
    """Initial trajectories: x (N+1, nx), u (N, nu), lam and gap (N, nlam)."""

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray


@dataclass(frozen=True)
class PeerAnswer:
    """Result that a script's user sees; ``ok`` if every stage succeeded."""

    cost: float
    iterations: int
    setup_s: float
    ok: bool
    complementarity: float


class Script:
    """A script with a variable per block, a loop over the steps, and ``subject_to`` for every constraint.

    ``equality`` states ``lam gap = t``, the relaxed law; otherwise ``lam gap <= t`` (Scholtes).
    IPOPT has the options of the workbench. ``simple_bounds`` asks CasADi to find bounds on single
    variables among the constraints, which few scripts do: the NLP is then the same as the
    workbench's, to the last iteration.
    """

    def __init__(self, model: Model, equality: bool, simple_bounds: bool = False) -> None:
        began = time.process_time()
        opti, N = ca.Opti(), model.N
        X, U = opti.variable(model.nx, N + 1), opti.variable(model.nu, N)
        LAM, GAP = opti.variable(model.nlam, N), opti.variable(model.nlam, N)
        t = opti.parameter()
        cost, u_before = 0, ca.DM(model.u_before)
        opti.subject_to(X[:, 0] == ca.DM(model.x0))
        for k in range(N):
            x, u, lam, gap = X[:, k], U[:, k], LAM[:, k], GAP[:, k]
            residual, opening = model.relation(x, u, X[:, k + 1], lam)
            opti.subject_to(residual == 0)
            opti.subject_to(gap == opening)
            opti.subject_to(lam >= 0)
            opti.subject_to(gap >= 0)
            opti.subject_to(lam * gap == t if equality else lam * gap <= t)
            opti.subject_to(opti.bounded(-model.u_max, u, model.u_max))
            cost += model.stage(x, u, u - u_before)
            u_before = u
        opti.minimize(cost + model.terminal(X[:, N]))
        plugin = {"print_time": False, "detect_simple_bounds": simple_bounds}
        opti.solver("ipopt", plugin, IPOPT_DEFAULTS)
        self.opti, self.blocks, self.t = opti, (X, U, LAM, GAP), t
        self.setup_s = time.process_time() - began

    def solve(self, guess: Guess, values: list[float]) -> PeerAnswer:
        """Solve at each value of t in turn, from the last solution but without its multipliers."""
        opti, iterations, ok = self.opti, 0, True
        start = (guess.x, guess.u, guess.lam, guess.gap)
        for block, value in zip(self.blocks, start, strict=True):
            opti.set_initial(block, value.T)
        read = ca.Function("read", [opti.x, opti.p], [opti.f, ca.vec(self.blocks[2] * self.blocks[3])])
        cost, worst = np.nan, np.nan
        for t in values:
            opti.set_value(self.t, t)
            try:
                opti.solve()
            except RuntimeError:
                ok = False
            iterations += int(opti.debug.stats()["iter_count"])
            point = opti.debug.value(opti.x)
            cost, products = read(point, t)
            worst = float(ca.norm_inf(products))
            opti.set_initial(opti.x, point)
        return PeerAnswer(float(cost), iterations, self.setup_s, ok, worst)


def relaxed(model: Model, guess: Guess, mu: float, simple_bounds: bool = False) -> PeerAnswer:
    """Set up and solve ``lam gap = mu``."""
    return Script(model, True, simple_bounds).solve(guess, [mu])


def scholtes(model: Model, guess: Guess) -> PeerAnswer:
    """Set up and solve ``lam gap <= t``, t = 1, 0.1, ... 1e-8, every stage to tight tolerance."""
    return Script(model, False).solve(guess, SCHOLTES)
