"""Audit of a result: residuals recomputed from its trajectories, and a replay under the exact law."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem
from ocp.judge.constraints import Violation, broken_constraints, noticeable_violations, tolerance_sizes
from ocp.judge.contact_report import ContactReport, ContactSummary, contact_report, largest_entry
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, roll_on
from ocp.programs.solver import Result
from ocp.transcription.nlp import NLP, Trajectories

TOLERANCES = {
    "dynamics_residual": 1e-8,
    "law_residual": 1e-7,
    "constraint_violation": 1e-6,
    "complementarity": 1e-8,
}
"""Mapping from residuals to their tolerances, in natural units; complementarity counts only under the exact law."""
_CONTACT_FIELDS = (
    "cone_violation",
    "dissipation_residual",
    "energy_gain",
    "dissipated",
    "momentum_residual",
    "contacts",
)
"""Fields that an audit copies from the contact report."""
_LEAST_IMPULSE = 1e-7
"""Multiplier [N s] up to which a pair counts as inactive."""
_WORST_COUNT = 5
"""Maximum number of violations that a list contains."""


@dataclass(frozen=True)
class Audit:
    """Residuals recomputed from the trajectories, and the replay under the exact law.

    Residuals are the largest values over contacts and steps: ``complementarity`` of lam gap [N s m],
    ``complementarity_min`` of min(lam, gap), ``dynamics_residual`` of |residual|, ``law_residual`` of |lam gap - mu|,
    ``constraint_violation`` of the violations of bounds, path and terminal constraints, ``penetration`` of max(0,
    -phi) with the true signed distance phi, and ``state_gap`` of |x - x_replay|. ``exact_cost`` and
    ``exact_penetration`` are those of the replay. ``active_steps`` counts the pairs, including friction pairs, whose
    lam exceeds their gap, over all steps; ``task_gradient`` is computed by :func:`task_gradient` if there are none, and
    NaN otherwise, since derivatives of a step with many pairs take minutes.

    With friction, ``cone_violation`` is the largest max(0, |tangential| - friction normal) [N s], and
    ``dissipation_residual`` [J] the largest energy by which friction dissipates less than it could.
    If the energy is known, ``energy_gain`` [J] is its largest increase in one step beyond the work done
    (due to contact or integrator), ``dissipated`` [J] the energy that contact dissipates in all steps, and
    ``momentum_residual`` [N s] the largest error of the momentum balance. ``contacts`` summarises the times,
    impulses and sliding distances of each contact. ``replay_failed`` names the step at which the
    replay ended early, or is ""; ``replay_broken`` contains the worst noticeable violation of every kind in the
    replay.
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


def audit_result(
    nlp: NLP, result: Result, plan: Trajectories, evaluation: Evaluation, p: np.ndarray, bounds: dict[str, np.ndarray]
) -> tuple[Audit, Rollout, ContactReport]:
    """Return the audit of a result, its replay under the exact law, and the report on the plan's contacts.

    The replay uses the plan's inputs or, with feedback, its policy from the start of each scenario.
    """
    inputs = plan.u if plan.gains is None else plan.gains
    replay, unsolved = roll_on(evaluation, inputs, x0=plan.x[:, 0])
    product_sizes, law_residuals, dynamics_residuals = _natural(nlp, plan)
    _, g = nlp.values(result.point.x, p)
    x_off = np.maximum(bounds["lbx"] - result.point.x, result.point.x - bounds["ubx"])
    g_off = np.maximum(bounds["lbg"] - g, g - bounds["ubg"]) / nlp.natural.g
    violations = np.concatenate([x_off / nlp.natural.x, _without_contact(nlp, g_off)])
    state_sizes = tolerance_sizes(nlp.problem, plan.x)
    smallest = np.minimum(plan.lam, plan.gap)
    # A learned law has no pairs: its complementarity is NaN, not zero.
    pairs = nlp.step.n >= nlp.problem.system.nlam
    report = contact_report(evaluation, nlp.step, plan)
    active_steps = int(np.sum(plan.lam > np.maximum(plan.gap, _LEAST_IMPULSE)))
    audit = Audit(
        complementarity=largest_entry(product_sizes) if pairs else float("nan"),
        complementarity_min=largest_entry(np.abs(smallest)) if pairs else float("nan"),
        dynamics_residual=largest_entry(dynamics_residuals),
        law_residual=largest_entry(law_residuals),
        constraint_violation=max(0.0, largest_entry(violations)),
        penetration=_penetration(evaluation, plan.x, plan.gap),
        exact_penetration=_penetration(evaluation, replay.x, replay.gap),
        exact_cost=replay.cost,
        state_gap=largest_entry(np.abs(plan.x - replay.x)),
        active_steps=active_steps,
        task_gradient=task_gradient(evaluation, replay) if active_steps == 0 else float("nan"),
        worst=worst_constraints(nlp, result.point.x, g, bounds),
        **{name: getattr(report, name) for name in _CONTACT_FIELDS},
        replay_failed="" if unsolved is None else unsolved.brief,
        replay_broken=noticeable_violations(broken_constraints(evaluation, replay, state_sizes)),
    )
    return audit, replay, report


def _natural(nlp: NLP, plan: Trajectories) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``|lam gap|``, ``|lam gap - mu|`` and ``|residual|`` of a plan in natural units."""
    units, natural = nlp.natural, nlp.problem.natural
    pair, rows = natural.impulse * natural.gap, nlp.problem.residual_units
    if "gap" in nlp.variables:
        pair = np.prod([units.x[nlp.variables[name].index] for name in ("lam", "gap")], axis=0)
        rows = units.g[nlp.constraints["dynamics"].index]
    products = plan.lam * plan.gap
    return np.abs(products / pair), np.abs((products - plan.mu) / pair), np.abs(plan.residual / rows)


def _without_contact(nlp: NLP, violation: np.ndarray) -> np.ndarray:
    """Return the violations without the rows that define contact, which other residuals measure."""
    is_judged = np.ones(violation.size, dtype=bool)
    for name in ("contact", "separation"):
        if name in nlp.constraints:
            is_judged[nlp.constraints[name].index.ravel()] = False
    return violation[is_judged]


def _penetration(evaluation: Evaluation, x: np.ndarray, gap: np.ndarray) -> float:
    phi = evaluation.signed_distances(x)
    return max(0.0, largest_entry(-(gap if phi is None else phi)))


def task_gradient(evaluation: Evaluation, replay: Rollout) -> float:
    """Return the largest derivative of the contact part of the cost with respect to an input, in relative terms.

    The result is the largest entry of ``B_k' nu_{k+1} + D_k' dl/dlam``, where ``nu_k = dl/dx + A_k' nu_{k+1} + C_k'
    dl/dlam`` along the exact replay, over the sum of ``|dl/dx|`` and ``|dl/dlam|``; A, B, C, D are the derivatives of
    the next state and of lam with respect to x and u. The contact part is the part that depends on impulses and on
    states that inputs move only through contact, since motion of an arm alone does not move the object. Returns NaN
    without such a part.
    """
    steered, touched = steered_and_touched(evaluation.problem.system)
    mask = np.where(touched & ~steered, 1.0, 0.0)
    if not ((mask.any() or evaluation.problem.uses_impulses) and np.all(np.isfinite(replay.x))):
        return float("nan")
    largest, size = _slopes(evaluation, replay, mask)
    return largest / size if np.isfinite(size) and size > 0 else float("nan")


def steered_and_touched(system: ContactSystem) -> tuple[np.ndarray, np.ndarray]:
    """Return masks (nx,) of the states that inputs affect while contacts are open, and that contacts affect."""
    arguments = [system.x, system.u, system.parameters.vector]
    free = ca.Function("free", arguments, [system.reduced.a, system.reduced.B])
    sparsities = free.jac_sparsity(0, 0), free.jac_sparsity(0, 1), free.sparsity_out(1)
    by_x, by_u, by_lam = (np.array(ca.DM(sparsity, 1)) for sparsity in sparsities)
    steered, touched = by_u.any(axis=1, keepdims=True) > 0, by_lam.any(axis=1, keepdims=True) > 0
    for _ in range(system.nx):
        steered, touched = steered | (by_x @ steered > 0), touched | (by_x @ touched > 0)
    return steered.ravel(), touched.ravel()


@np.errstate(over="ignore", invalid="ignore")
def _slopes(evaluation: Evaluation, replay: Rollout, mask: np.ndarray) -> tuple[float, float]:
    """Return two numbers for the part of the cost in masked states and lam.

    They are its largest derivative by an input, and the sum of the absolute values of its derivatives.
    """
    problem = evaluation.problem
    step, physical = problem.exact_step, evaluation.p
    p = step.p.pack(evaluation.values)
    slopes = problem.state_slopes
    jacobian = step.map.jacobian()
    u_before = evaluation.limits.u_before
    largest, size = 0.0, 0.0
    for s in range(len(replay.x)):
        u = replay.u[s]
        increments = np.diff(np.vstack([u_before, u]), axis=0)
        x, x_next, n = replay.x[s, :-1], replay.x[s, 1:], problem.system.nx
        lam, m = replay.impulses[s], u.shape[1]
        by_x, _, by_lam = slopes(x.T, u.T, increments.T, lam.T, physical)
        cost_by_x, cost_by_lam = mask * np.array(by_x).T, np.array(by_lam).T
        terminal_slope = slopes(x_next[-1], u[-1], increments[-1], lam[-1], physical)[1]
        nu = mask * np.array(terminal_slope).ravel()
        size += np.abs(cost_by_x).sum() + np.abs(nu).sum() + np.abs(cost_by_lam).sum()
        derivatives = jacobian(x.T, u.T, p, x_next.T, replay.lam[s].T)
        A, B, C, D = (np.array(derivatives[i]) for i in (0, 1, 3, 4))
        for k in reversed(range(problem.N)):
            x_columns, u_columns = slice(k * n, (k + 1) * n), slice(k * m, (k + 1) * m)
            by_input = B[:, u_columns].T @ nu + D[:, u_columns].T @ cost_by_lam[k]
            largest = max(largest, float(np.abs(by_input).max(initial=0.0)))
            nu = cost_by_x[k] + A[:, x_columns].T @ nu + C[:, x_columns].T @ cost_by_lam[k]
    return largest, size


def is_feasible(nlp: NLP, audit: Audit) -> bool:
    """Return whether audited residuals are below tolerance; complementarity is judged only under the exact law."""
    limits = {key: getattr(audit, key) for key in TOLERANCES}
    if not nlp.step.exact:
        limits.pop("complementarity")
    elif nlp.method == "direct":
        limits.pop("law_residual")
    return all(np.isfinite(v) and v <= TOLERANCES[key] for key, v in limits.items())


def worst_constraints(nlp: NLP, x: np.ndarray, g: np.ndarray, bounds: dict[str, np.ndarray]) -> list[Violation]:
    """Return up to five violations of constraints and bounds, the largest first."""
    g_off = np.maximum(bounds["lbg"] - g, g - bounds["ubg"])
    x_off = np.maximum(bounds["lbx"] - x, x - bounds["ubx"])
    violations = np.concatenate([g_off, x_off])
    order = np.argsort(-np.nan_to_num(violations, nan=np.inf))[:_WORST_COUNT]
    worst = []
    for position in order:
        if not violations[position] > 0:
            continue
        in_g = position < g.size
        layout = nlp.constraints if in_g else nlp.variables
        block, index = layout.locate(int(position if in_g else position - g.size))
        component = block.components[index[-1]] if block.components else str(index[-1])
        name = block.name if in_g else f"bound on {block.name}"
        scenario, k = (index[0], index[1]) if len(index) == 3 else (0, index[0])
        worst.append(Violation(name, component, scenario, k, float(violations[position])))
    return worst
