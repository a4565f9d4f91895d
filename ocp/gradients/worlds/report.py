"""Report on gradients of simulators: measurements, their comparison with the exact output, and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.settings import Configured, setting
from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.gradients.sampling import ReferenceGradient, quadrature
from ocp.gradients.verdict import Jump, sharpest_change_on_lines
from ocp.gradients.worlds.judging import Measures, judge_world
from ocp.gradients.worlds.measures import (
    FIRST_ORDER,
    ZEROTH_ORDER,
    Secants,
    local_slopes,
    measure_secants,
    nearby_points,
    own_reference,
    reach_noise,
    smoothed_gradient,
    value_range,
)
from ocp.gradients.worlds.world import World, WorldObjective, check_world
from ocp.judge.findings import Finding
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.json_values import to_json

if TYPE_CHECKING:
    import xarray as xr

JUMP_SHARE, OWN_JUMP_SHARE = 0.2, 0.5
"""Smallest jumps that make a gradient undefined: of the exact output, and of a simulator's output if the exact one is
unknown. Both are shares of the range of the output over the largest amplitude."""
TRUTH_POINTS = 1 << 18
"""Number of quadrature points for the smoothed gradient of the exact output."""


@dataclass(frozen=True)
class ReportSettings(Configured):
    """Settings of a report: samples, noise and refinements, and the tolerance within which a slope is right.

    ``sigmas`` are standard deviations of the noise, as shares of the parameter's size.
    """

    tolerance: float = setting(0.05, "largest error of a right slope, as a share of the exact slope", above=0, below=1)
    samples: int = setting(
        2000, "samples of each smoothed gradient", hint="one sample has no variance", least=2, most=10**9
    )
    sigmas: Sequence[float] = (1e-3, 1e-2, 1e-1)
    refinements: int = setting(2, "number of times that a simulator is refined", least=0, most=6)
    seed: int = setting(0, "seed of the noise", least=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sigmas or not min(self.sigmas) > 0:
            raise InputError(f"sigmas must be one or more positive numbers, got {list(self.sigmas)}")


@dataclass(frozen=True)
class Question:
    """Derivative to be judged: of output ``output`` with respect to parameter ``parameter``, at ``theta`` (d,).

    ``size`` > 0 is the characteristic size of the parameter, to which amplitudes are relative. ``truth`` computes the
    exact output and, if possible, its gradient; it is None if these are unknown. ``signals`` are the names and units
    of the parameter and the output.
    """

    theta: np.ndarray
    size: float
    truth: World | None = None
    parameter: int = 0
    output: int = 0
    signals: tuple[Signal, Signal] = (Signal("theta", "1"), Signal("y", "1"))

    def objective(self, world: World) -> WorldObjective:
        """Return the output of a simulator as a function of the parameter."""
        return WorldObjective(world, self.theta, self.parameter, self.output, self.signals[0])


class _Truth:
    """Exact output of a question: its secants, slopes at nearby points, largest jump and smoothed gradients."""

    def __init__(self, question: Question, truth: World) -> None:
        n_outputs, _ = check_world(truth, question.theta)
        if question.output >= n_outputs:
            raise InputError(f"{truth.name} has {n_outputs} outputs, got {question.output} as the index of the output")
        self.objective, self._size = question.objective(truth), question.size
        self.secants = measure_secants(self.objective, question.size)
        points = nearby_points(float(self.objective.theta[0]), question.size)
        self.nearby = local_slopes(self.objective, points, float(self.secants.amplitudes[self.secants.sharpest]))
        self.jump = dominant_jump(self.objective, question.size)

        self._smoothed: dict[float, ReferenceGradient] = {}

    def smoothed(self, sigma: float) -> ReferenceGradient:
        """Return the exact gradient smoothed with noise of standard deviation ``sigma``, by quadrature."""
        if sigma not in self._smoothed:
            self._smoothed[sigma] = quadrature(self.objective, sigma, TRUTH_POINTS)
        return self._smoothed[sigma]


def dominant_jump(objective: WorldObjective, size: float, share: float = JUMP_SHARE) -> Jump | None:
    """Return the largest jump within the largest amplitude, or None if below ``share`` times the output's range."""
    jump = sharpest_change_on_lines(objective, *reach_noise(size))
    return jump if jump.discontinuous and jump.size > share * value_range(objective, size) else None


@dataclass(frozen=True)
class GradientReport:
    """Measurements of several simulators for one derivative, with verdicts; ``rows`` has a JSON object for each."""

    question: Question
    rows: list[dict[str, Any]]

    @property
    def sentences(self) -> list[str]:
        """One sentence for each simulator: its name and its verdict."""
        return [f"{row['world']}: {row['sentence']}" for row in self.rows]

    def dataset(self) -> xr.Dataset:
        """Return the measurements of simulators that did not fail, as arrays over (world, amplitude) with units."""
        import xarray as xr

        parameter, output = self.question.signals
        rows = [row for row in self.rows if row["status"] == "done"]
        unit, names = {"units": f"({output.unit})/({parameter.unit})"}, [row["world"] for row in rows]
        amplitudes = ("amplitude", rows[0]["amplitudes"], {"units": parameter.unit})
        data = xr.Dataset(coords={"world": names, "amplitude": amplitudes})
        for key in ("secants", "ahead", "behind", "errors", "truth_secants", "slope", "truth"):
            if rows[0][key] is not None:
                values = np.array([row[key] for row in rows], dtype=float)
                data[key] = (("world", "amplitude")[: values.ndim], values, unit)
        data["verdict"] = ("world", [row["verdict"] for row in rows])
        return data


def measure_worlds(
    worlds: Sequence[World],
    question: Question,
    settings: ReportSettings | None = None,
    files: SavedWork = UNSAVED,
    progress: Callable[[int, str], None] | None = None,
) -> GradientReport:
    """Measure the gradient of each simulator; judge whether it is its output's derivative, and the exact derivative.

    Finished simulators are saved to ``files``, from which the same call resumes. A simulator that raises
    :class:`~ocp.errors.InputError` gets a row with the status ``failed``, and the others are measured. ``progress``
    is called with the number of finished simulators and the name of the next one.

    Raises :class:`~ocp.errors.InputError` if all simulators fail, or if the exact output cannot be computed.
    """
    settings, rows, failures = settings or ReportSettings(), [], []
    truth = None if question.truth is None else _Truth(question, question.truth)
    for index, world in enumerate(worlds):
        if progress is not None:
            progress(index, world.name)
        saved = files.rows(index)
        if saved is None:
            try:
                saved = [to_json(_measure_world(world, question, truth, settings))]
            except InputError as error:
                failures.append(error)
                rows.append({"world": world.name, "status": "failed", "verdict": "failed", "sentence": str(error)})
                continue
            files.save_rows(index, saved)
        rows += saved
    if len(failures) == len(worlds):
        raise failures[0]
    return GradientReport(question, rows)


def _measure_world(world: World, question: Question, truth: _Truth | None, settings: ReportSettings) -> dict[str, Any]:
    """Return the measurements of one simulator with its verdict, as a JSON object."""
    n_outputs, nonfinite = check_world(world, question.theta)
    if question.output >= n_outputs:
        raise InputError(f"{world.name} has {n_outputs} outputs, got {question.output} as the index of the output")
    measures = _Measurement(world, question, truth, settings).run()
    findings = judge_world(measures, settings.tolerance)
    secants = measures.secants
    return {
        "world": world.name,
        "status": "done",
        "verdict": findings[0].code.removeprefix("gradient-"),
        "sentence": _sentence(findings),
        "findings": [finding.document for finding in findings],
        "method": world.method if world.differentiate is not None else "differences",
        "settings": dict(world.settings),
        "versions": dict(world.versions),
        "nonfinite": nonfinite,
        "slope": measures.slope,
        "truth": measures.truth,
        "nearby": measures.nearby,
        "noise": secants.noise,
        "amplitudes": secants.amplitudes,
        "secants": secants.slopes,
        "ahead": secants.ahead,
        "behind": secants.behind,
        "errors": secants.errors,
        "truth_secants": measures.truth_secants,
        "refinements": measures.refinements,
        "smoothed": measures.smoothed,
    }


def _sentence(findings: Sequence[Finding]) -> str:
    return "; ".join(finding.sentence for finding in findings) + "."


class _Measurement:
    """Measurement of one simulator for one derivative."""

    def __init__(self, world: World, question: Question, truth: _Truth | None, settings: ReportSettings) -> None:
        self._world, self._question, self._truth, self._settings = world, question, truth, settings
        self._objective = question.objective(world)

    def run(self) -> Measures:
        """Return all measurements on which the verdict depends."""
        truth, size = self._truth, self._question.size
        secants = measure_secants(self._objective, size)
        slopes = self._slopes(self._objective, secants)
        # If the exact output is unknown, slopes are compared with the secant over the largest amplitude.
        true_slopes = np.full(len(slopes), secants.slopes[-1]) if truth is None else truth.nearby
        jump = dominant_jump(self._objective, size, OWN_JUMP_SHARE) if truth is None else truth.jump
        return Measures(
            slope=float(slopes[0]),
            nearby=slopes[1:],
            truth=float(true_slopes[0]),
            nearby_truth=true_slopes[1:],
            secants=secants,
            truth_secants=None if truth is None else truth.secants.slopes,
            has_gradient=self._world.differentiate is not None,
            jump=None if jump is None else (jump.size, float(self._objective.theta[0] + jump.place[0])),
            refinements=self._refinements(),
            smoothed=self._smoothed(),
        )

    def _slopes(self, objective: WorldObjective, secants: Secants) -> np.ndarray:
        points = nearby_points(float(objective.theta[0]), self._question.size)
        return local_slopes(objective, points, float(secants.amplitudes[secants.sharpest]))

    def _refinements(self) -> list[dict[str, Any]]:
        """Return rows for 0, 1, 2, ... refinements: settings, slope, and median size and error of nearby slopes."""
        rows = []
        for times in range(self._settings.refinements + 1 if self._world.sharper else 0):
            world = self._world.refined(times)
            objective = self._question.objective(world)
            slopes = self._slopes(objective, measure_secants(objective, self._question.size))
            truth = slopes[:1] * np.nan if self._truth is None else self._truth.nearby
            rows.append(
                {
                    "settings": {name: world.settings[name] for name in world.sharper},
                    "slope": float(slopes[0]),
                    "typical": float(np.median(np.abs(slopes))),
                    "error": float(np.median(np.abs(slopes - truth))),
                }
            )
        return rows

    def _smoothed(self) -> list[dict[str, Any]]:
        """Return zeroth-order estimates at every sigma and, for a simulator with derivatives, first-order estimates."""
        rows, truth = [], self._truth
        for index, share in enumerate(self._settings.sigmas):
            sigma = share * self._question.size
            seed = np.random.SeedSequence(self._settings.seed, spawn_key=(index,))
            reference = None if truth is None else truth.smoothed(sigma)
            n = self._settings.samples
            zeroth = smoothed_gradient(self._objective, ZEROTH_ORDER, sigma, reference, n, seed)
            rows.append(zeroth)
            if self._world.differentiate is not None and self._world.samples_gradient:
                compared = own_reference(zeroth) if reference is None and np.isfinite(zeroth["mean"]) else reference
                rows.append(smoothed_gradient(self._objective, FIRST_ORDER, sigma, compared, n, seed))
        return rows
