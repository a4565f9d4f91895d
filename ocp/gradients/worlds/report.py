"""Report on gradients of simulators: measurements, their comparison with the exact output, and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.settings import Configured, setting
from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.gradients.sampling import ReferenceGradient, quadrature
from ocp.gradients.worlds.judging import Measures, judge_world
from ocp.gradients.worlds.measures import (
    FIRST_ORDER,
    ZEROTH_ORDER,
    dominant_jump,
    measure_slopes,
    nearby_points,
    own_reference,
    smoothed_gradient,
)
from ocp.gradients.worlds.world import World, WorldObjective, check_world
from ocp.judge.findings import Finding
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
    of the parameter and the output, ``points`` the number of quadrature points for the smoothed exact gradient.
    ``further_findings`` returns further findings on a simulator.
    """

    theta: np.ndarray
    size: float
    truth: World | None = None
    parameter: int = 0
    output: int = 0
    signals: tuple[Signal, Signal] = (Signal("theta", "1"), Signal("y", "1"))
    points: int = TRUTH_POINTS
    further_findings: Callable[[World], list[Finding]] = lambda world: []

    def objective(self, world: World) -> WorldObjective:
        """Return the output of a simulator as a function of the parameter."""
        return WorldObjective(world, self.theta, self.parameter, self.output, self.signals[0])

    def check(self, world: World) -> int:
        """Return the number of non-finite rows of :func:`check_world`; raise InputError if there is no such output."""
        n_outputs, nonfinite = check_world(world, self.theta)
        if self.output >= n_outputs:
            raise InputError(f"{world.name} has {n_outputs} outputs, got {self.output} as the index of the output")
        return nonfinite


class _Truth:
    """Exact output: its secants, slopes at nearby points, largest jump and smoothed gradients."""

    def __init__(self, question: Question, truth: World) -> None:
        question.check(truth)
        self._question, self.objective = question, question.objective(truth)
        self.secants, self.nearby = measure_slopes(self.objective, question.size)
        self.jump = dominant_jump(self.objective, question.size, JUMP_SHARE)
        self._smoothed: dict[float, ReferenceGradient] = {}

    def smoothed(self, sigma: float) -> ReferenceGradient:
        """Return the exact gradient smoothed with noise of standard deviation ``sigma``, by quadrature."""
        if sigma not in self._smoothed:
            self._smoothed[sigma] = quadrature(self.objective, sigma, self._question.points)
        return self._smoothed[sigma]


@dataclass(frozen=True)
class GradientReport:
    """Measurements of several simulators for one or more derivatives, with verdicts.

    ``rows`` has a JSON object for each simulator and derivative.
    """

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


class Measurements:
    """Measurements of simulators for one or more questions of equal size, numbered question after question.

    Measurement ``index`` does not depend on the others, so that they can be made in any order and process.
    """

    def __init__(
        self, worlds: Sequence[World], questions: Question | Sequence[Question], settings: ReportSettings | None = None
    ) -> None:
        self.questions = [questions] if isinstance(questions, Question) else questions
        self._pairs, self._settings = [*product(range(len(self.questions)), worlds)], settings or ReportSettings()
        self._truths: dict[int, _Truth | None] = {}
        self.names = [
            world.name + f" along {self.questions[number].signals[0].name}" * (len(self.questions) > 1)
            for number, world in self._pairs
        ]
        """Name of the simulator of each measurement and, of several questions, of the parameter."""

    def row(self, index: int, note: Callable[[str], None]) -> dict[str, Any]:
        """Return a measurement with its verdict, as a JSON object; ``note`` is called with texts on the progress.

        Raises :class:`~ocp.errors.InputError` if the simulator or the exact output cannot be computed.
        """
        number, world = self._pairs[index]
        question, name = self.questions[number], self.names[index]
        note(name)
        if number not in self._truths:
            self._truths[number] = None if question.truth is None else _Truth(question, question.truth)
        noted = replace(world, note=lambda text: note(f"{name}: {text}"))
        return to_json({"world": name} | _measure_world(noted, question, self._truths[number], self._settings))

    def failed_row(self, index: int, error: Exception) -> dict[str, Any]:
        """Return the row of a measurement that raised ``error``."""
        sentence = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        return {"world": self.names[index], "status": "failed", "verdict": "failed", "sentence": sentence}


def _measure_world(world: World, question: Question, truth: _Truth | None, settings: ReportSettings) -> dict[str, Any]:
    """Return the measurements of one simulator with its verdict, as a JSON object."""
    nonfinite = question.check(world)
    measures = _measures(world, question, truth, settings)
    findings = [*judge_world(measures, settings.tolerance), *question.further_findings(world)]
    secants, exact = measures.secants, measures.truth_secants
    return {
        "status": "done",
        "verdict": findings[0].code.removeprefix("gradient-"),
        "sentence": "; ".join(finding.sentence for finding in findings) + ".",
        "findings": [finding.document for finding in findings],
        "method": world.method if world.differentiate is not None else "differences",
        "settings": dict(world.settings),
        "versions": dict(world.versions),
        "nonfinite": nonfinite,
        **{
            name: getattr(measures, name)
            for name in ("slope", "truth", "nearby", "refinements", "horizons", "smoothed")
        },
        **{name: getattr(secants, name) for name in ("noise", "amplitudes", "ahead", "behind", "errors")},
        "secants": secants.slopes,
        "truth_secants": None if exact is None else exact.slopes,
    }


def _measures(world: World, question: Question, truth: _Truth | None, settings: ReportSettings) -> Measures:
    """Return all measurements of a simulator on which the verdict depends."""
    objective, size = question.objective(world), question.size
    secants, slopes = measure_slopes(objective, size)
    if truth is None:
        # If the exact output is unknown, slopes are those of the parabola through the largest finite secant.
        widest = max(np.flatnonzero(np.isfinite(secants.ahead - secants.behind)), default=-1)
        amplitude, curvature = secants.amplitudes[widest], secants.ahead[widest] - secants.behind[widest]
        offsets = nearby_points(objective.theta[0], size) - objective.theta[0]
        true_slopes, jump = (
            secants.slopes[widest] + curvature / amplitude * offsets,
            dominant_jump(objective, size, OWN_JUMP_SHARE),
        )
    else:
        true_slopes, jump = truth.nearby, truth.jump
    times = settings.refinements
    return Measures(
        slope=float(slopes[0]),
        nearby=slopes[1:],
        truth=float(true_slopes[0]),
        nearby_truth=true_slopes[1:],
        secants=secants,
        truth_secants=None if truth is None else truth.secants,
        has_gradient=world.differentiate is not None,
        jump=None if jump is None else (jump.size, float(objective.theta[0] + jump.noise[0])),
        refinements=_changes(world, world.sharper, times, question, truth),
        horizons=_changes(world, world.longer, times, question, None),
        smoothed=_smoothed(objective, size, truth, settings),
    )


def _changes(
    world: World, factors: Mapping[str, float], times: int, question: Question, truth: _Truth | None
) -> list[dict[str, Any]]:
    """Return rows for settings multiplied 0, 1, 2, ... times: slope, and median size and error of nearby slopes."""
    rows = []
    for count in range(times + 1 if factors else 0):
        settings = {name: world.settings[name] * factor**count for name, factor in factors.items()}
        _, slopes = measure_slopes(question.objective(world.at(settings)), question.size)
        error = np.nan if truth is None else float(np.median(np.abs(slopes - truth.nearby)))
        rows.append(
            {
                "settings": settings,
                "slope": float(slopes[0]),
                "typical": float(np.median(np.abs(slopes))),
                "error": error,
            }
        )
    return rows


def _smoothed(
    objective: WorldObjective, size: float, truth: _Truth | None, settings: ReportSettings
) -> list[dict[str, Any]]:
    """Return zeroth-order estimates at every sigma and, for a simulator with derivatives, first-order estimates."""
    rows, world, n = [], objective.world, settings.samples
    for index, share in enumerate(settings.sigmas):
        sigma, seed = share * size, np.random.SeedSequence(settings.seed, spawn_key=(index,))
        reference = None if truth is None else truth.smoothed(sigma)
        zeroth = smoothed_gradient(objective, ZEROTH_ORDER, sigma, reference, n, seed)
        rows.append(zeroth)
        if world.differentiate is not None and world.samples_gradient:
            compared = own_reference(zeroth) if reference is None and np.isfinite(zeroth["mean"]) else reference
            rows.append(smoothed_gradient(objective, FIRST_ORDER, sigma, compared, n, seed))
    return rows
