"""What the judges of a solution found, as records that a run keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ocp.physics.constraints import Violation
from ocp.physics.contact_report import ContactSummary
from ocp.physics.measures import Worst


@dataclass(frozen=True)
class Audit:
    """Residuals recomputed from the trajectories, and the replay under the exact law.

    ``complementarity`` is max lam gap [N s m], ``complementarity_min`` max min(lam, gap), both
    over all contacts and steps; ``dynamics_residual`` max |residual|, ``law_residual`` max
    |lam gap - mu|, ``constraint_violation`` of bounds, path and terminal constraints,
    ``penetration`` max(0, -phi) with phi the true signed distance, ``exact_cost`` the cost of the
    replay, ``state_gap`` max |x - x_replay|. ``active_steps`` counts (step, contact) pairs in
    contact; ``task_gradient`` is the largest change per unit input of the cost of what contact
    alone moves, NaN where it moves nothing alone.

    With friction, largest over contacts and steps: ``cone_violation`` max(0, |tangential| -
    friction normal) [N s] and ``dissipation_residual`` [J], what friction misses of the most it
    could take. Where energy is known: ``energy_gain`` [J] the largest rise in one step beyond the
    work done, contact's and the integrator's, ``dissipated`` [J] what contact took in all,
    ``momentum_residual`` [N s]. ``contacts`` tells of each contact when it acts, how hard, and how
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


@dataclass(frozen=True)
class RefereeFindings:
    """What the sharpest contact makes of a plan, see :mod:`ocp.judges.referee`.

    ``cost`` and ``gap``, the largest difference of a state from the plan, are those of its replay;
    ``survives_at_h`` is None without geometry, and ``reasons`` say why it is False, each half a
    sentence. ``survives`` says that the replay holds at h/4 too where h only discretises, and
    ``refined_reasons`` why it does not. ``note`` names what the referee has that the model has not.
    ``refined_cost`` is the cost at h/4, NaN with the reason in ``refined_note``. Of plan and
    replay: how deep bodies are in one another at the nodes (``penetration``) and on the way between
    them (``between``), and the largest true distance at which a normal force acts
    (``force_distance``), all [m]. ``broken`` are the constraints that the replay breaks.
    ``nonuniqueness`` describes the first step of the plan at which the model's contact has another
    solution, "" where there is none.
    """

    cost: float = math.nan
    gap: float = math.nan
    survives: bool | None = None
    reasons: list[str] = field(default_factory=list)
    note: str = ""
    refined_cost: float = math.nan
    refined_note: str = ""
    penetration: Worst | None = None
    between: Worst | None = None
    force_distance: Worst | None = None
    replay_penetration: Worst | None = None
    replay_between: Worst | None = None
    broken: list[Violation] = field(default_factory=list)
    nonuniqueness: str = ""
    survives_at_h: bool | None = None
    refined_reasons: list[str] = field(default_factory=list)

    @property
    def word(self) -> str:
        """The referee's word: one of three, or that there is none."""
        if self.survives_at_h and not self.survives:
            return "survives at this step only"
        return {True: "survives", False: "does not survive", None: "no referee"}[self.survives]
