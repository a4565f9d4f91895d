"""Plans that do little: the cost of standing still, and contacts or states that a plan leaves unused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import ContactSystem
from ocp.judge.audit import steered_and_touched
from ocp.judge.constraints import broken_constraints
from ocp.judge.contact_report import ContactSummary
from ocp.judge.findings import Finding, make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, roll_on

CONTENT = 1e-4
"""Gradient of the cost, as a fraction of the cost's span, up to which standing still counts as optimal."""
STILL = 0.05
"""Largest motion of states over the horizon, as a fraction of their sizes, under an input that counts as holding."""
_UNMOVED_SHARE = 0.01
"""Largest motion of a state, as a fraction of its characteristic size, that counts as no motion."""
_STEEP_SHARE = 0.01
"""Slope of the cost per characteristic size, as a fraction of its span, above which a state matters to the cost."""
_FORCE_UNITS = ("N", "N m", "N s")
"""Units of inputs that are zero in free fall; inputs with other units, such as commanded positions, are held."""


def cost_span(evaluation: Evaluation, plan: Rollout) -> float:
    """Return the largest change of the cost as all states and inputs change by a characteristic size.

    The dynamics are ignored, so that instability has no effect.
    """
    sizes = evaluation.problem.scales
    costs = [
        evaluation.trajectory_costs(plan.x + s * sizes.x, plan.u + s * sizes.u, plan.impulses) for s in (-1.0, 1.0)
    ]
    return float(np.nan_to_num([np.abs(c - plan.costs).max() for c in costs]).max())


def idle_cost(evaluation: Evaluation, step: Step, plan: Rollout) -> float:
    """Return the cost of doing nothing from the plan's start, the lowest of three costs.

    These are the costs of holding the input that acts before the first step, of holding this input with forces set to
    zero, and of staying at the initial states. The third cost counts only if one of the plan's inputs can hold the
    states and the cost depends on the states; it does not include the cost of that input.

    Returns NaN if none of the three is possible and satisfies the constraints.
    """
    u_before = evaluation.limits.u_before
    falling = np.where([signal.unit in _FORCE_UNITS for signal in step.system.inputs], 0.0, u_before)
    costs = [_still_cost(evaluation, step, plan), _constant_cost(evaluation, step, plan, u_before)]
    if np.any(falling != u_before):
        costs.append(_constant_cost(evaluation, step, plan, falling))
    return float(np.fmin.reduce(costs))


def _constant_cost(evaluation: Evaluation, step: Step, plan: Rollout, u: np.ndarray) -> float:
    """Return the cost of one input (nu,) at all steps, NaN if a step fails or constraints are violated."""
    idle, unsolved = roll_on(evaluation, np.tile(u, (1, evaluation.problem.N, 1)), step, plan.x[:, 0])
    if unsolved is not None or broken_constraints(evaluation, idle):
        return float("nan")
    return idle.cost


def _still_cost(evaluation: Evaluation, step: Step, plan: Rollout) -> float:
    N, u_before = evaluation.problem.N, evaluation.limits.u_before
    x, u = np.repeat(plan.x[:, :1], N + 1, axis=1), np.tile(u_before, (len(plan.x), N, 1))
    tolerance, S, p = STILL * evaluation.problem.scales.x / N, len(x), step.p.pack(evaluation.values)
    if not all(_holds(step, p, x[s, 0], plan.u[s], tolerance) for s in range(S)):
        return float("nan")
    no_impulses = np.zeros_like(plan.impulses)
    costs = evaluation.trajectory_costs(x, u, no_impulses)
    idle_rollout = replace(plan, x=x, u=u, impulses=no_impulses, costs=costs)
    slope = max(_state_slopes(evaluation, x[s, 0]).max(initial=0.0) for s in range(S))
    if slope <= CONTENT * cost_span(evaluation, idle_rollout):
        return float("nan")
    return float("nan") if broken_constraints(evaluation, idle_rollout) else idle_rollout.cost


def _state_slopes(evaluation: Evaluation, x: np.ndarray) -> np.ndarray:
    """Return the first-order change (nx,) of the cost of staying at x (nx,) as each state changes by its size."""
    problem, u_before = evaluation.problem, evaluation.limits.u_before
    stage_slope, terminal_slope, _ = problem.state_slopes(x, u_before, 0 * u_before, 0, evaluation.p)
    return problem.scales.x * np.abs(problem.N * np.array(stage_slope) + np.array(terminal_slope)).ravel()


def _holds(step: Step, p: np.ndarray, x: np.ndarray, inputs: np.ndarray, limit: np.ndarray) -> bool:
    """Return whether one of ``inputs`` (N, nu) keeps every state of x (nx,) within ``limit`` (nx,)."""
    x_start = np.repeat(x[:, None], len(inputs), axis=1)
    x_next = np.array(step.solve.map(len(inputs))(x_start, inputs.T, p)[0])
    return bool(np.any(np.all(np.abs(x_next - x_start) <= limit[:, None], axis=0)))


def undone_findings(
    evaluation: Evaluation, plan: Rollout, contacts: list[ContactSummary], span: float
) -> Iterator[Finding]:
    """Yield findings on bodies that a plan leaves untouched and states that it does not move, if they matter.

    The cost depends on a state if its slope per characteristic size, at the start or the end, exceeds a
    hundredth of the cost's ``span``. A state that inputs move only through contact, and on which the cost
    depends at the end, is untouched if no contact with an actuated body is ever active.
    """
    problem, moves = evaluation.problem, np.ptp(plan.x, axis=1).max(axis=0, initial=0.0)
    starts, ends = (
        np.array([_state_slopes(evaluation, x) for x in plan.x[:, node]]).max(axis=0) > _STEEP_SHARE * span
        for node in (0, -1)
    )
    steered, touched = steered_and_touched(problem.system)
    passive, names = touched & ~steered, np.array([signal.name for signal in problem.system.states])
    if np.any(ends & passive):
        driven = set(_driven_contacts(problem.system, steered, passive))
        acts = {contact.name: contact.steps + contact.distant > 0 for contact in contacts if contact.name in driven}
        if acts and not any(acts.values()):
            yield _untouched([*acts], names[passive])
    if np.any(ends) and not np.any((starts | ends) & (moves > _UNMOVED_SHARE * problem.scales.x)):
        yield make_finding("nothing-moves", states=names[starts | ends].tolist())


def _driven_contacts(system: ContactSystem, steered: np.ndarray, passive: np.ndarray) -> list[str]:
    """Return the contacts whose gap depends on ``steered`` states and that move ``passive`` states, masks (nx,)."""
    names = tuple(signal.name for signal in system.contacts) if system.forces is None else system.forces.names
    is_moved = np.array(ca.DM(system.reduced.B.sparsity(), 1))[passive].any(axis=0)
    jacobian = ca.jacobian_sparsity(system.gap, ca.vertcat(system.x, system.x_next))
    near_steered = np.array(ca.DM(jacobian, 1)) @ np.tile(steered, 2) > 0
    pairs = zip(system.pairs, near_steered & is_moved, strict=True)
    return [names[pair.contact] for pair, joins in pairs if joins and pair.kind == "normal"]


def _untouched(contacts: list[str], passive_states: np.ndarray) -> Finding:
    """Return the finding that no contact acts, with the names of the bodies if contacts are named "a on b"."""
    bodies = [re.sub(r" \d+$", "", name).split(" on ") for name in contacts]
    if any(len(pair) != 2 for pair in bodies):
        named = f"contact{'s' * (len(contacts) > 1)} {', '.join(contacts)}"
        return make_finding("contact-never-acts", contacts=named, plural="s" * (len(contacts) == 1))
    is_passive = {body: any(body in state for state in passive_states) for pair in bodies for body in pair}
    ordered = [sorted(pair, key=is_passive.__getitem__) for pair in bodies]
    driven, passive = (
        " and ".join(dict.fromkeys(f"the {body}" for body in side)) for side in zip(*ordered, strict=True)
    )
    return make_finding("never-touches", bodies=driven, others=passive, plural="es" * (" and " not in driven))
