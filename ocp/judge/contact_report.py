"""Contact along a trajectory: forces, slip, stick, energy and momentum, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import ContactSystem, EnergyBalance
from ocp.judge.measures import TrajectoryEvaluator, slip_sides
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Scales
from ocp.problem.rollout import Rollout, mean_multipliers
from ocp.transcription.nlp import Trajectories

_ACTIVE_SHARE = 1e-6
"""Normal impulse above which a contact counts as acting, as a fraction of the characteristic impulse."""
_SLIP_SHARE = 1e-6
"""Distance slid in a step above which a contact counts as slipping, as a fraction of the characteristic gap."""
_BIACTIVE_SHARE = 1e-5
"""Values below which both members of a pair count as zero, as a fraction of their characteristic sizes."""


@dataclass(frozen=True)
class ContactSummary:
    """Summary of one contact over all scenarios and steps.

    ``steps`` counts the steps at which it is active (:func:`active_contacts`), ``slipping`` the steps at which it
    is active and slips, ``distant`` the steps with a force at a distance, and ``degenerate`` the steps without strict
    complementarity: impulse and gap are both near zero, and gradients are one-sided. ``peak_force`` [N] is the largest
    normal force, and ``slid`` [m] the distance slid while active; ``spans`` are the (first, last) steps of active
    phases in the first scenario.
    """

    name: str
    steps: int
    slipping: int
    peak_force: float
    slid: float
    degenerate: int
    spans: list[tuple[int, int]] = field(default_factory=list)
    distant: int = 0


@dataclass(frozen=True)
class ContactReport:
    """Forces, energy and momentum of a trajectory; arrays (S, N, points), NaN if a system has no such quantity.

    ``normal`` and ``tangential`` are impulses [N s] and ``slip`` is a velocity [m/s] (in space, lengths of
    vectors). ``bound`` is the largest possible tangential impulse, friction times normal [N s]. ``active``,
    ``slipping`` and ``degenerate`` say whether the contact is active (:func:`active_contacts`), whether it
    slips while active, and whether its complementarity is not strict. The following are largest values over
    all contacts and steps: ``cone_violation`` max(0, |tangential| - friction normal) [N s];
    ``dissipation_residual`` friction normal |slip| + tangential slip [J], zero under maximum dissipation;
    ``energy_gain`` [J], the increase of energy in a step beyond the work done; and
    ``momentum_residual`` [N s]. ``dissipated`` [J] is the energy that contact dissipates in all steps.
    """

    names: tuple[str, ...]
    normal: np.ndarray
    tangential: np.ndarray
    slip: np.ndarray
    bound: np.ndarray
    active: np.ndarray
    slipping: np.ndarray
    degenerate: np.ndarray
    contacts: list[ContactSummary]
    cone_violation: float = float("nan")
    dissipation_residual: float = float("nan")
    energy_gain: float = float("nan")
    dissipated: float = float("nan")
    momentum_residual: float = float("nan")


def contact_report(evaluation: Evaluation, step: Step, rollout: Rollout | Trajectories) -> ContactReport:
    """Return forces, slip, energy and momentum of trajectories of ``step``.

    Multipliers of a law with branches are averaged with the branches' weights. The contacts are
    those of the step's system, which may differ from the problem's.
    """
    problem, system, (lam, gap) = evaluation.problem, step.system, (rollout.lam, rollout.gap)
    mean_lam = mean_multipliers(step, lam)
    evaluate = TrajectoryEvaluator(evaluation, system, rollout.x, rollout.u, mean_lam)
    forces = system.forces
    if forces is None:
        names = tuple(signal.name for signal in system.contacts)
        normal = mean_lam
        tangential = slip = friction = power = slip_size = np.zeros_like(mean_lam)
    else:
        names = forces.names
        normal, tangential, slip, friction = evaluate(forces.normal, forces.tangential, forces.slip, forces.friction)
        power, slip_size = tangential * slip, np.abs(slip)
        if forces.edges > 2:
            tangential, slip, power, slip_size = _in_space(tangential, slip, forces.edges)
    degenerate = _degenerate_steps(system, problem.scales, lam, gap, len(names))
    h = evaluate(ca.SX(system.h))[0]
    active, distant = active_contacts(
        normal / problem.scales.impulse, _gaps(step, gap, len(names)) / problem.scales.gap
    )
    slipping = active & (np.abs(slip) * h > _SLIP_SHARE * problem.scales.gap)
    # A multiplier in newtons is already a force.
    are_forces = forces is None and all(signal.unit == "N" for signal in system.contacts)
    force = normal if are_forces else normal / h
    contacts = _summaries(names, force, np.abs(slip) * h, active, slipping, degenerate, distant)
    bound, cone, dissipation = friction * normal, float("nan"), float("nan")
    if forces is not None:
        cone = largest_entry(np.abs(tangential) - bound)
        dissipation = largest_entry(bound * slip_size + power)
    per_step = (normal, tangential, slip, bound, active, slipping, degenerate)
    return ContactReport(names, *per_step, contacts, cone, dissipation, *_balances(system.energy_balance, evaluate))


def _in_space(
    tangential: np.ndarray, slip: np.ndarray, edges: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths of impulse and slip, the power, and the slip along the nearest edge, (S, N, points) each.

    In a friction pyramid with ``edges`` the impulse of maximum dissipation is on that edge.
    """
    components = [np.array(np.split(vectors, 2, axis=-1)) for vectors in (tangential, slip)]
    sizes = [np.hypot(*vectors) for vectors in components]
    angles = np.arange(edges) * 2 * np.pi / edges
    edge_slip = np.tensordot(np.array([np.cos(angles), np.sin(angles)]).T, components[1], 1)
    return *sizes, (components[0] * components[1]).sum(axis=0), edge_slip.max(axis=0)  # pyright: ignore


def active_contacts(normal: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return masks of active contacts, and of contacts that exert a force at a distance.

    ``normal`` impulses and ``gap`` have the same shape and are fractions of their characteristic sizes. An
    active contact has an impulse above 1e-6 and above its gap. A contact with an impulse above 1e-6 but not
    above its gap is not active: it exerts a force at a distance, due to smoothing.
    """
    return (normal > _ACTIVE_SHARE) & (normal > gap), (normal > _ACTIVE_SHARE) & (normal <= gap)


def _gaps(step: Step, gap: np.ndarray, points: int) -> np.ndarray:
    """Return the gap of every contact's normal pair, (S, N, points), zero for a contact without normal pair."""
    normal_gaps, mean_gaps = np.zeros((*gap.shape[:2], points)), mean_multipliers(step, gap)
    if step.system.forces is None:
        return mean_gaps
    for i, pair in enumerate(step.system.pairs):
        if pair.kind == "normal":
            normal_gaps[:, :, pair.contact] = mean_gaps[:, :, i]
    return normal_gaps


def _degenerate_steps(
    system: ContactSystem, scaling: Scales, lam: np.ndarray, gap: np.ndarray, points: int
) -> np.ndarray:
    """Return a mask of the steps at which a pair of the contact has both members near zero, (S, N, points)."""
    pairs = system.pairs
    near_zero = np.maximum(np.abs(lam) / scaling.impulse, np.abs(gap) / scaling.gap) < _BIACTIVE_SHARE
    degenerate = np.zeros((*lam.shape[:2], points), dtype=bool)
    for i in range(lam.shape[2]):
        pair = pairs[i % len(pairs)]
        if pair.kind == "normal":
            degenerate[:, :, pair.contact] |= near_zero[:, :, i]
    return degenerate


def _summaries(
    names: tuple[str, ...],
    force: np.ndarray,
    direction: np.ndarray,
    active: np.ndarray,
    slipping: np.ndarray,
    degenerate: np.ndarray,
    distant: np.ndarray,
) -> list[ContactSummary]:
    """Summarise every contact by its forces [N], distances slid [m] and masks, (S, N, points); [] without forces."""
    if np.isnan(force).all():
        return []
    return [
        ContactSummary(
            name=name,
            steps=int(active[:, :, i].sum()),
            slipping=int(slipping[:, :, i].sum()),
            peak_force=largest_entry(force[:, :, i]),
            slid=float(direction[:, :, i][active[:, :, i]].sum()),
            degenerate=int(degenerate[:, :, i].sum()),
            spans=_spans(active[0, :, i]),
            distant=int(distant[:, :, i].sum()),
        )
        for i, name in enumerate(names)
    ]


def _spans(active: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [(int(first), int(end) - 1) for first, end in pairs]


def _balances(balance: EnergyBalance | None, evaluate: TrajectoryEvaluator) -> tuple[float, float, float]:
    """Return ``energy_gain``, ``dissipated`` and ``momentum_residual``, NaN without an energy balance."""
    if balance is None:
        return float("nan"), float("nan"), float("nan")
    x, _, x_next, _, _ = evaluate.symbols
    next_quantities = [ca.substitute(quantity, x, x_next) for quantity in (balance.energy, balance.momentum)]
    energy_loss = balance.energy + balance.work - next_quantities[0]
    momentum_defect = next_quantities[1] - balance.momentum - balance.external
    losses, defects = evaluate(energy_loss, momentum_defect)
    return max(0.0, largest_entry(-losses)), float(losses.sum()), largest_entry(np.abs(defects))


def largest_entry(values: np.ndarray) -> float:
    """Return the largest of all entries, 0 for an empty array."""
    return float(np.max(values)) if values.size else 0.0


def least_slip(step: Step, lam: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lam and gap (..., n) with the smallest slip psi of every contact that its motion permits.

    In ``0 <= beta± ⟂ psi ± h J_t v+ >= 0`` and ``0 <= psi ⟂ f gamma - beta+ - beta- >= 0`` every psi
    of at least ``|h J_t v+|`` is a solution if gamma = 0. Under the exact law psi is reduced to this
    value, by the smallest friction gap of its contact; no product lam gap increases. Under a smoothed law
    psi is unique, and a learned law has no psi; lam and gap are then returned unchanged.
    """
    lam, gap = lam.copy(), gap.copy()
    if not step.exact or step.n < step.system.nlam:
        return lam, gap
    for rows, (slip, sides) in product(step.rows, slip_sides(step.system)):
        if sides:
            slip, sides = rows.start + slip, [rows.start + side for side in sides]
            spare = np.minimum(np.maximum(0, gap[..., sides].min(axis=-1)), lam[..., slip])
            lam[..., slip] -= spare
            gap[..., sides] -= spare[..., None]
    return lam, gap
