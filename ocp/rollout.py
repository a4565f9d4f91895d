"""Roll a plan out under a law, step by step, and say what it costs."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw, Step
from ocp.errors import NotConverged
from ocp.problem import Problem

STEP_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Gains:
    """Feedback ``u = K x + k``: K (N or 1, nu, nx), k (N or 1, nu)."""

    K: np.ndarray
    k: np.ndarray

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Input at a step and state."""
        at = min(step, len(self.K) - 1)
        return self.K[at] @ x + self.k[at]


@dataclass(frozen=True)
class Rollout:
    """Trajectories of all scenarios: x (S, N+1, nx), u (S, N, nu), lam and gap (S, N, n).

    ``costs`` (S,) are the scenarios' costs, ``cost`` their mean.
    """

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    costs: np.ndarray

    @property
    def cost(self) -> float:
        """Mean cost over scenarios."""
        return float(self.costs.mean())


def roll_out(
    problem: Problem,
    inputs: np.ndarray | Gains,
    values: dict[str, float],
    law: ContactLaw | Step | None = None,
    x0: np.ndarray | None = None,
) -> Rollout:
    """Roll out ``inputs`` (S or 1, N, nu), or gains, under ``law`` (the exact one if not said).

    ``values`` are parameter values by name; a law brings its own knobs, a closed step takes them
    from ``values``. ``x0`` (S, nx) are initial states, by default the problem's scenarios; inputs
    from gains are clipped to the bounds on u, as an actuator would.

    Raises :class:`~ocp.errors.NotConverged`, naming contact, step and scenario, where the step's
    path could not be followed to its end.
    """
    if law is None:
        step = problem.exact_step
    else:
        step = law if isinstance(law, Step) else law.close(problem.system)
    own = problem.parameters if step is not law else problem.parameters + step.p
    known = {name: value for name, value in values.items() if name in own}
    p = np.array([known.get(parameter.name, parameter.value) for parameter in step.p])
    physical = np.array([values[name] for name in problem.parameters.names])
    start = problem.initial_states(physical) if x0 is None else np.atleast_2d(x0)
    lower, upper = (np.array(v).ravel() for v in problem.limits(physical)[2:4])
    S, N = len(start), problem.N
    x = np.empty((S, N + 1, problem.system.nx))
    u = np.empty((S, N, problem.system.nu))
    lam, gap = np.empty((S, N, step.n)), np.empty((S, N, step.n))
    x[:, 0] = start
    for k in range(N):
        for s in range(S):
            if isinstance(inputs, Gains):
                u[s, k] = np.clip(inputs.input(k, x[s, k]), lower, upper)
            else:
                u[s, k] = inputs[min(s, len(inputs) - 1), k]
            after, lam_k, gap_k, error = step.solve(x[s, k], u[s, k], p)
            _check(step, np.array(error).ravel(), s, k)
            x[s, k + 1] = np.array(after).ravel()
            lam[s, k], gap[s, k] = np.array(lam_k).ravel(), np.array(gap_k).ravel()
    return Rollout(x, u, lam, gap, trajectory_costs(problem, x, u, physical))


def _check(step: Step, error: np.ndarray, scenario: int, k: int) -> None:
    if not np.all(error <= STEP_TOLERANCE):
        worst = int(np.nanargmax(np.where(np.isfinite(error), error, np.inf)))
        raise NotConverged(
            f"contact {step.contacts[worst].name!r} was not solved at step {k} of scenario"
            f" {scenario}: violation {error[worst]:.1e}; the state there may be far out of range"
        )


def trajectory_costs(
    problem: Problem, x: np.ndarray, u: np.ndarray, physical: np.ndarray
) -> np.ndarray:
    """Cost of each trajectory, x (S, N+1, nx), u (S, N, nu); returns (S,)."""
    before = np.array(problem.limits(physical)[1]).ravel()
    costs = np.empty(len(x))
    terms = problem.cost_terms
    for s in range(len(x)):
        du = np.diff(np.vstack([before, u[s]]), axis=0)
        stage, _ = terms(x[s, :-1].T, u[s].T, du.T, physical)
        _, terminal = terms(x[s, -1], u[s, -1], du[-1], physical)
        costs[s] = float(ca.sum2(stage)) + float(terminal)
    return costs
