"""What a solve gives back: labelled trajectories, an audit, and a verdict in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.contact import ContactLaw
from dynamics.systems import LAW_PREFIX
from ocp.errors import InputError
from ocp.factories import closing_law
from ocp.judges.findings import Audit, RefereeFindings
from ocp.judges.verdict import Grade, grade, headline, verdict
from ocp.plugins import load_plugin
from ocp.problem import Problem
from ocp.programs.status import Status
from ocp.replay import Replay, replayed
from ocp.rollout import Gains
from ocp.stationarity.certificate import Certificate
from ocp.words.tilde import expanded

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class StageRecord:
    """One stage of a homotopy: what it varies, at which value, and what the solver reached.

    ``evaluation_s`` of its ``seconds`` went into evaluating the NLP and its derivatives.
    """

    label: str
    value: float
    cost: float
    complementarity: float
    residual: float
    iterations: int
    seconds: float
    status: str
    accepted: bool = True
    evaluation_s: float = 0.0


@dataclass(frozen=True, repr=False)
class Solution:
    """A solved (or not) problem.

    ``certificate`` says whether the point is stationary for the problem that was asked,
    ``referee`` what the sharpest contact makes of it,
    ``idle_cost`` what standing still would cost under the same law
    (:func:`~ocp.judgement.idle_cost`).

    ``data`` holds, labelled and with units, over dimensions scenario, node (N+1), interval (N),
    state, control, contact: ``x`` (scenario, node, state), ``u`` (scenario, interval, control),
    ``lam``, ``gap``, ``mu`` (scenario, interval, contact), their replay under the exact law
    ``x_replay``, ``u_replay``, ``lam_replay``, ``gap_replay`` (contact_exact: without branches),
    under the referee ``x_referee``, ``u_referee``,
    ``phi``, ``phi_replay`` (scenario, node, distance) where the system knows its signed distance,
    with friction ``normal_impulse``, ``friction_impulse``, ``slip``, ``friction_bound`` (friction
    times normal impulse) and, as 0 or 1, ``active``, ``slipping``, ``degenerate`` (scenario,
    interval, point) of every contact, and their ``_replay``, for feedback ``K`` (interval, control,
    state) and ``k`` (interval, control), and the homotopy's stages: ``stage_value``,
    ``stage_cost``, ``stage_complementarity``, ``stage_residual``, ``stage_iterations`` (stage), and
    ``stage_x``, ``stage_u`` (accepted_stage, scenario or shared, interval, state or control) of
    those that succeeded. Coordinate ``time`` [s].

    Of ``solve_s`` [s], ``evaluation_s`` went into evaluating cost, constraints and derivatives;
    ``solver_s``, the rest, into the solver: linear algebra, line search, its own affairs. It is
    NaN where that was not measured.

    ``record`` is everything else, ready for JSON (:mod:`ocp.store.runs`): problem, contact,
    method, policy, solver, parameters, settings, seed.
    """

    data: xr.Dataset
    cost: float
    status: Status
    audit: Audit
    certificate: Certificate
    referee: RefereeFindings
    idle_cost: float
    stages: list[StageRecord]
    iterations: int
    build_s: float
    solve_s: float
    record: dict[str, Any]
    problem: Problem
    values: dict[str, float]
    gains: Gains | None = None
    others: list[dict[str, Any]] = field(default_factory=list)
    evaluation_s: float = math.nan
    derivative: Callable[[str], xr.Dataset] | None = None

    def sensitivity(self, name: str) -> xr.Dataset:
        """How the solution changes per unit of a parameter: x, u and cost.

        See :mod:`ocp.stationarity.sensitivity`.
        Raises :class:`~ocp.errors.InputError` for an unknown name, for a point that is no solution,
        and where there is no derivative.
        """
        if self.derivative is None:
            raise InputError("a point that was not solved has no sensitivity; solve it first")
        return self.derivative(name)

    @property
    def solver_s(self) -> float:
        """Seconds of the solve that were no evaluation of functions."""
        return self.solve_s - self.evaluation_s

    @property
    def iteration_s(self) -> dict[str, float]:
        """Mean seconds an iteration, ``evaluation`` and ``solver``; NaN where there was none."""
        count = self.iterations or math.nan
        return {"evaluation": self.evaluation_s / count, "solver": self.solver_s / count}

    def replay(
        self,
        law: ContactLaw | str = "exact",
        contact_settings: Mapping[str, Any] | None = None,
        **parameters: Any,
    ) -> Replay:
        """Roll the plan out under another law, a name with its settings or an object.

        Open loop: the same inputs; feedback: the same policy from each scenario.

        Raises :class:`~ocp.errors.InputError` for a law that is none, or cannot close the system,
        and :class:`~ocp.errors.NotConverged` where one of its steps did not solve.
        """
        settings = {**(contact_settings or {}), **parameters}
        made = closing_law(law, settings, self.problem.system)
        return replayed(self.problem, self.data, self.cost, self.gains, self.values, made)

    def plot(self) -> Figure:
        """Draw what ``ocp solve --plot`` writes: strobe above states, inputs and forces."""
        return load_plugin("reports").plot(self)

    def animate(self, path: Path | str, fps: int = 25, speed: float = 1.0) -> Path:
        """Write the motion, plan beside replay, to a .gif, .mp4 or .html, as ``ocp animate`` does.

        Raises :class:`~ocp.errors.InputError` for another ending, and for a problem not drawn.
        """
        return load_plugin("reports").animate(self, expanded(path), fps, speed)

    def report(self, path: Path | str) -> Path:
        """Write the PDF of ``ocp report``; :class:`~ocp.errors.InputError` where it cannot be."""
        return load_plugin("reports").report(self, expanded(path))

    def save(self, root: Path | str | None = None, tags: Sequence[str] = ()) -> Path:
        """Store it as ``ocp solve`` does and return the run's directory, for :func:`ocp.load`.

        ``root`` is ``$OCP_RUNS``, else ``runs``, where none is said; ``tags`` mark the run.

        Raises :class:`~ocp.errors.InputError` where ``root`` cannot be written, and for a tag that
        is no word.
        """
        return load_plugin("reports").save(self, root, tags)

    @property
    def success(self) -> bool:
        """Whether the audit, not the solver, says that this is an answer."""
        return self.status is Status.SOLVED

    @property
    def verdict(self) -> str:
        """Headline with costs and survival, then a line a finding (:mod:`ocp.judges.verdict`)."""
        return verdict(self)

    def __repr__(self) -> str:
        asked = self.record
        given = asked["law_parameters"].items()
        parameters = "".join(f" {name.removeprefix(LAW_PREFIX)}={v:g}" for name, v in given)
        law = f"{asked['contact']}{parameters}"
        how = f"{asked['problem']}, {law}, {asked['method']}, {asked['policy']}"
        return f"<Solution of {how}: {headline(self)}>"

    def _repr_html_(self) -> str:
        return load_plugin("reports").html(self)

    @property
    def grade(self) -> Grade:
        """``survives``, ``certified`` (and no more) or ``failed``: what the verdict's colour is."""
        return grade(self)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a solve: ``solution`` is the best so far.

    Of several starts that is the best finished one; if none has finished, the best point of the
    first, with status :attr:`~ocp.programs.status.Status.INTERRUPTED`.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__("interrupted; the best point so far is kept")
        self.solution = solution
