"""Recompute the residuals that a solver reports, and replay the plan under the exact law."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.judge.constraints import Violation, broken_constraints, noticeable, seen_sizes
from ocp.judge.contact_report import ContactReport, ContactSummary, contact_report, largest
from ocp.judge.measures import distances
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout, roll_on, trajectory_costs
from ocp.programs.solver import Result
from ocp.transcription.nlp import NLP, Trajectories

TOLERANCES = {
    "dynamics_residual": 1e-8,
    "law_residual": 1e-7,
    "constraint_violation": 1e-6,
    "complementarity": 1e-8,
}
"""What ``success`` demands; complementarity only of the exact law."""
_OF_BOOK = ("cone_violation", "dissipation_residual", "energy_gain", "dissipated", "momentum_residual", "contacts")
"""What a contact report gives the audit."""
_ACTIVE = 1e-7
_WORST = 5
CONTENT = 1e-4
"""Share of the cost's span below which its gradient is flat: standing still is optimal."""
STILL = 0.05
"""Share of the states' characteristic size that an input may move in a horizon and yet hold."""


@dataclass(frozen=True)
class Audit:
    """Residuals recomputed from the trajectories, and the replay under the exact law.

    ``complementarity`` is max lam gap [N s m], ``complementarity_min`` max min(lam, gap), both
    over all contacts and steps; ``dynamics_residual`` max |residual|, ``law_residual`` max
    |lam gap - mu|, ``constraint_violation`` of bounds, path and terminal constraints,
    ``penetration`` max(0, -phi) with phi the true signed distance, ``exact_cost`` the cost of the
    replay, ``state_gap`` max |x - x_replay|. ``active_steps`` counts complementarity
    pairs, friction's too, over the steps with lam above its gap; ``task_gradient`` is the largest
    change per unit input of the cost of what contact alone moves, NaN where it moves nothing alone.

    With friction, largest over contacts and steps: ``cone_violation`` max(0, |tangential| -
    friction normal) [N s] and ``dissipation_residual`` [J], what friction misses of the most it
    could take. Where energy is known: ``energy_gain`` [J] the largest rise in one step beyond the
    work done, contact's and the integrator's, ``dissipated`` [J] what contact took in all,
    ``momentum_residual`` [N s]. ``contacts`` summarises when each contact acts, how hard, and how
    far it slides. ``replay_failed`` names the step at which the replay ended, "" where it did not;
    ``replay_broken`` the constraints that it breaks by what can be seen, the worst of every kind.
    """

    complementarity: float
    complementarity_min: float
    dynamics_residual: float
    law_residual: float
    constraint_violation: float
    penetration: float
    exact_penetration: float
    exact_cost: float
    state_gap: float
    active_steps: int
    task_gradient: float
    worst: list[Violation] = field(default_factory=list)
    cone_violation: float = math.nan
    dissipation_residual: float = math.nan
    energy_gain: float = math.nan
    dissipated: float = math.nan
    momentum_residual: float = math.nan
    contacts: list[ContactSummary] = field(default_factory=list)
    replay_failed: str = ""
    replay_broken: list[Violation] = field(default_factory=list)


def signed_distances(problem: Problem, x: np.ndarray, physical: np.ndarray) -> np.ndarray | None:
    """True signed distance phi of every contact, (S, N+1, n_phi), or None if unknown."""
    if problem.signed_distance is None:
        return None
    return distances(problem, x, physical)


def audit(
    nlp: NLP,
    result: Result,
    plan: Trajectories,
    values: dict[str, float],
    p: np.ndarray,
    bounds: dict[str, np.ndarray],
) -> tuple[Audit, Rollout, ContactReport]:
    """Judge a result by its trajectories, and replay it under the exact law.

    Open loop: the same inputs. Feedback: the same policy from each scenario. The book is that of
    the plan's contacts.
    """
    problem = nlp.problem
    physical = problem.parameters.pack(values)
    inputs = plan.u if plan.gains is None else plan.gains
    replay, unsolved = roll_on(problem, inputs, values, x0=plan.x[:, 0])
    sharp, closed, moved = _natural(nlp, plan)
    _, g = nlp.values(result.point.x, p)
    x_off = np.maximum(bounds["lbx"] - result.point.x, result.point.x - bounds["ubx"])
    g_off = np.maximum(bounds["lbg"] - g, g - bounds["ubg"]) / nlp.natural.g
    free = np.concatenate([x_off / nlp.natural.x, _without_contact(nlp, g_off)])
    seen = seen_sizes(problem, plan.x)
    smallest = np.minimum(plan.lam, plan.gap)
    # A learned law has no pairs, which is not the same as pairs that are complementary.
    pairs = nlp.step.n >= problem.system.nlam
    book = contact_report(problem, nlp.step, plan.x, plan.u, plan.lam, plan.gap, physical)
    found = Audit(
        complementarity=largest(sharp) if pairs else float("nan"),
        complementarity_min=largest(np.abs(smallest)) if pairs else float("nan"),
        dynamics_residual=largest(moved),
        law_residual=largest(closed),
        constraint_violation=max(0.0, largest(free)),
        penetration=_penetration(problem, plan.x, plan.gap, physical),
        exact_penetration=_penetration(problem, replay.x, replay.gap, physical),
        exact_cost=replay.cost,
        state_gap=largest(np.abs(plan.x - replay.x)),
        active_steps=int(np.sum(plan.lam > np.maximum(plan.gap, _ACTIVE))),
        task_gradient=task_gradient(problem, replay, values),
        worst=worst_constraints(nlp, result.point.x, g, bounds),
        **{name: getattr(book, name) for name in _OF_BOOK},
        replay_failed="" if unsolved is None else unsolved.brief,
        replay_broken=noticeable(broken_constraints(problem, replay.x, replay.u, replay.impulses, physical, seen)),
    )
    return found, replay, book


def _natural(nlp: NLP, plan: Trajectories) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``|lam gap|``, ``|lam gap - mu|`` and ``|residual|`` in natural units."""
    units, natural = nlp.natural, nlp.problem.natural
    pair, rows = natural.impulse * natural.gap, nlp.problem.residual_units
    if "gap" in nlp.variables:
        pair = np.prod([units.x[nlp.variables[name].index] for name in ("lam", "gap")], axis=0)
        rows = units.g[nlp.constraints["dynamics"].index]
    products = plan.lam * plan.gap
    return (
        np.abs(products / pair),
        np.abs((products - plan.mu) / pair),
        np.abs(plan.residual / rows),
    )


def _without_contact(nlp: NLP, violation: np.ndarray) -> np.ndarray:
    """Leave out the closure of contact, which is judged by lam and gap themselves."""
    kept = np.ones(violation.size, dtype=bool)
    for name in ("contact", "separation"):
        if name in nlp.constraints:
            kept[nlp.constraints[name].index.ravel()] = False
    return violation[kept]


def _penetration(problem: Problem, x: np.ndarray, gap: np.ndarray, physical: np.ndarray) -> float:
    phi = signed_distances(problem, x, physical)
    return max(0.0, largest(-(gap if phi is None else phi)))


def task_gradient(problem: Problem, replay: Rollout, values: dict[str, float]) -> float:
    """Largest derivative of the contact part of the cost with respect to any input, relative.

    ``B_k' nu_{k+1} + D_k' dl/dlam`` with ``nu_k = dl/dx + A_k' nu_{k+1} + C_k' dl/dlam`` along the
    exact replay, over the sum of ``|dl/dx|`` and ``|dl/dlam|``; A, B, C, D are the derivatives of
    the next state and of lam by x and u. It is zero where no input moves anything that the task is
    about: the impulses, and the states that inputs move through contact alone. An arm that goes
    back to its rest is no progress with the object. NaN where the cost depends on neither.
    """
    mask = _moved_by_contact_alone(problem)
    if not ((mask.any() or problem.uses_impulses) and np.all(np.isfinite(replay.x))):
        return float("nan")
    largest, size = _slopes(problem, replay, values, mask)
    return largest / size if np.isfinite(size) and size > 0 else float("nan")


def _moved_by_contact_alone(problem: Problem) -> np.ndarray:
    """1 for every state that a contact reaches, and no input while all contacts are open."""
    system = problem.system
    given = [system.x, system.u, system.parameters.vector]
    free = ca.Function("free", given, [system.reduced.a, system.reduced.B])
    by_x, by_u = (np.array(ca.DM(free.jac_sparsity(0, i), 1)) for i in range(2))
    steered, touched = by_u.any(axis=1), np.array(ca.DM(free.sparsity_out(1), 1)).any(axis=1)
    for _ in range(system.nx):
        steered, touched = steered | (by_x @ steered > 0), touched | (by_x @ touched > 0)
    return np.where(touched & ~steered, 1.0, 0.0)


@np.errstate(over="ignore", invalid="ignore")
def _slopes(problem: Problem, replay: Rollout, values: dict[str, float], mask: np.ndarray) -> tuple[float, float]:
    """Largest derivative by an input of the cost on the masked states, and its slopes' sum."""
    step = problem.exact_step
    physical = problem.parameters.pack(values)
    p = step.p.pack(values)
    slopes = problem.state_slopes
    jacobian = step.map.jacobian()
    before = np.array(problem.limits(physical)[1]).ravel()
    largest, size = 0.0, 0.0
    for s in range(len(replay.x)):
        u = replay.u[s]
        increments = np.diff(np.vstack([before, u]), axis=0)
        x, after, n = replay.x[s, :-1], replay.x[s, 1:], problem.system.nx
        lam, m = replay.impulses[s], u.shape[1]
        by_x, _, by_lam = slopes(x.T, u.T, increments.T, lam.T, physical)
        here, of_lam = mask * np.array(by_x).T, np.array(by_lam).T
        end = slopes(after[-1], u[-1], increments[-1], lam[-1], physical)[1]
        nu = mask * np.array(end).ravel()
        size += np.abs(here).sum() + np.abs(nu).sum() + np.abs(of_lam).sum()
        found = jacobian(x.T, u.T, p, after.T, replay.lam[s].T)
        A, B, C, D = (np.array(found[i]) for i in (0, 1, 3, 4))
        for k in reversed(range(problem.N)):
            of_x, of_u = slice(k * n, (k + 1) * n), slice(k * m, (k + 1) * m)
            by_input = B[:, of_u].T @ nu + D[:, of_u].T @ of_lam[k]
            largest = max(largest, float(np.abs(by_input).max(initial=0.0)))
            nu = here[k] + A[:, of_x].T @ nu + C[:, of_x].T @ of_lam[k]
    return largest, size


def feasible(nlp: NLP, found: Audit) -> bool:
    """Whether the audited residuals are below tolerance: complementarity of the exact law only."""
    limits = {key: getattr(found, key) for key in TOLERANCES}
    if not nlp.step.exact:
        limits.pop("complementarity")
    elif nlp.method == "direct":
        limits.pop("law_residual")
    return all(np.isfinite(v) and v <= TOLERANCES[key] for key, v in limits.items())


def worst_constraints(nlp: NLP, x: np.ndarray, g: np.ndarray, bounds: dict[str, np.ndarray]) -> list[Violation]:
    """Return the five most violated constraints and bounds, by name, scenario and step."""
    g_off = np.maximum(bounds["lbg"] - g, g - bounds["ubg"])
    x_off = np.maximum(bounds["lbx"] - x, x - bounds["ubx"])
    off = np.concatenate([g_off, x_off])
    order = np.argsort(-np.nan_to_num(off, nan=np.inf))[:_WORST]
    worst = []
    for position in order:
        if not off[position] > 0:
            continue
        in_g = position < g.size
        layout = nlp.constraints if in_g else nlp.variables
        block, index = layout.locate(int(position if in_g else position - g.size))
        component = block.components[index[-1]] if block.components else str(index[-1])
        name = block.name if in_g else f"bound on {block.name}"
        scenario, k = (index[0], index[1]) if len(index) == 3 else (0, index[0])
        worst.append(Violation(name, component, scenario, k, float(off[position])))
    return worst


def cost_span(problem: Problem, plan: Rollout, physical: np.ndarray) -> float:
    """What the cost changes by, at most, as all states and inputs move by a characteristic size.

    They move freely, not along a motion, so that no instability enters.
    """
    sizes = problem.scales
    costs = [
        trajectory_costs(problem, plan.x + s * sizes.x, plan.u + s * sizes.u, plan.impulses, physical)
        for s in (-1.0, 1.0)
    ]
    return float(np.nan_to_num([np.abs(c - plan.costs).max() for c in costs]).max())


def idle_cost(problem: Problem, step: Step, values: dict[str, float], plan: Rollout) -> float:
    """Cost of standing still where the plan starts: the lower one of two ways to do so.

    Either the input before the first is held, under the law. Or the states stay, where one of the
    plan's inputs can hold them and the cost has a slope in them; the holding itself costs nothing.
    NaN where neither is possible, or violates constraints that the plan satisfies.
    """
    given = problem, step, values, plan
    return float(np.fmin(_held_cost(*given), _still_cost(*given)))


def _held_cost(problem: Problem, step: Step, values: dict[str, float], plan: Rollout) -> float:
    physical = problem.parameters.pack(values)
    held = np.tile(np.array(problem.limits(physical)[1]).ravel(), (1, problem.N, 1))
    idle, unsolved = roll_on(problem, held, values, step, plan.x[:, 0])
    moved = idle.x, idle.u, idle.impulses
    if unsolved is not None or broken_constraints(problem, *moved, physical):
        return float("nan")
    return idle.cost


def _still_cost(problem: Problem, step: Step, values: dict[str, float], plan: Rollout) -> float:
    N = problem.N
    physical = problem.parameters.pack(values)
    before = np.array(problem.limits(physical)[1]).ravel()
    x, u = np.repeat(plan.x[:, :1], N + 1, axis=1), np.tile(before, (len(plan.x), N, 1))
    limit, S, p = STILL * problem.scales.x / N, len(x), step.p.pack(values)
    if not all(_holds(step, p, x[s, 0], plan.u[s], limit) for s in range(S)):
        return float("nan")
    free = np.zeros_like(plan.impulses)
    costs = trajectory_costs(problem, x, u, free, physical)
    still = replace(plan, x=x, u=u, impulses=free, costs=costs)
    slope = max(_state_slope(problem, x[s, 0], physical) for s in range(S))
    if slope <= CONTENT * cost_span(problem, still, physical):
        return float("nan")
    return float("nan") if broken_constraints(problem, x, u, free, physical) else still.cost


def _state_slope(problem: Problem, x: np.ndarray, physical: np.ndarray) -> float:
    """Most that staying at x (nx,) costs more where one state moves by its size, first order."""
    before = problem.limits(physical)[1]
    stage, end, _ = problem.state_slopes(x, before, 0 * before, 0, physical)
    slopes = np.abs(problem.N * np.array(stage) + np.array(end)).ravel()
    return float((problem.scales.x * slopes).max(initial=0.0))


def _holds(step: Step, p: np.ndarray, x: np.ndarray, inputs: np.ndarray, limit: np.ndarray) -> bool:
    """Whether one of ``inputs`` (N, nu) moves no state of x (nx,) by more than ``limit`` (nx,)."""
    start = np.repeat(x[:, None], len(inputs), axis=1)
    after = np.array(step.solve.map(len(inputs))(start, inputs.T, p)[0])
    return bool(np.any(np.all(np.abs(after - start) <= limit[:, None], axis=0)))
