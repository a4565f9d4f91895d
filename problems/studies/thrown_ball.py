"""A7: throws of a ball learned with four kinds of policy gradients, and landscapes of the return."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.learning.experiment import Experiment
from ocp.learning.explorer import squash
from ocp.learning.protocol import Algorithm
from ocp.learning.unroll_gradients import FOPG, SHARP_LAW, ZOPG
from ocp.problem.task import Task
from problems.studies.shared.trainings import claim_gains, mean_difference, mean_height, smallest_margin
from problems.studies.study import Claim, StudyParams, claim, dataset, format_values, setting, settings_text
from problems.tasks.registry import get

NOTES = (
    "The paper gives no numbers: ball, floor and goal are those of the task ball-throw, whose"
    " goal is where 0.6 rad at 3 m/s leads, so that the best return is 0 but for the scheme.",
    "The decision is angle and speed; the paper turns the angle alone.",
    "Every curve is the return of the decision itself, without noise, under the exact law.",
    "All methods have as many samples, the same rate, the same starts and Adam.",
)
QUICK = {"runs": 3, "iterations": 60}

MUS = (1e-4, 1e-3, 1e-2)
"""Central-path parameters of the barrier laws [N s m]."""
ANGLES = (-0.8, 1.2)
"""Range of the angles in the landscapes [rad]."""
SPEEDS = (1.5, 4.5)
"""Range of the speeds in the landscapes [m/s]."""


class Params(StudyParams):
    """Parameters of study A7; all defaults are our choice, since the paper states none."""

    runs: int = setting(10, "1", "runs, each from a throw of its own", least=2)
    iterations: int = setting(100, "1", "steps of ascent", least=2)
    samples: int = setting(16, "1", "throws in a gradient, of each method", least=4)
    sigma: float = setting(0.1, "1", "noise on the decision before it is bounded", above=0)
    rate: float = setting(0.02, "1", "Adam's rate", above=0)
    angle: float = setting(-0.3, "rad", "angle that runs start around", least=-1, most=1)
    speed: float = setting(3.0, "m/s", "speed that runs start around", least=2, most=4)
    spread: float = setting(0.2, "1", "how far runs start apart, uniform", least=0, most=0.4)
    grid: int = setting(61, "1", "points of a landscape along each axis", least=9)


def make_methods(params: Params) -> dict[str, tuple[Algorithm, ContactLaw]]:
    """Return a mapping from each method to its algorithm and the contact law of its gradients."""
    n_even = params.samples + params.samples % 2
    options = {"samples": n_even, "unroll": get("ball-throw").horizon, "sigma": params.sigma, "rate": params.rate}
    first = FOPG(**options)
    return {
        "ZOPG": (ZOPG(**options), SHARP_LAW),
        "FOPG": (first, SHARP_LAW),
        **{f"BS {mu:g}": (first, Barrier(mu=mu)) for mu in MUS},
        "ABS quartic": (first, Adaptive("quartic")),
        "ABS gaussian": (first, Adaptive(sigma=0.1)),
    }


def run(params: Params) -> xr.Dataset:
    """Compute decisions and exact returns of every run, and each law's return over a grid of decisions."""
    task, algorithms = get("ball-throw"), make_methods(params)
    names = list(algorithms)
    decisions = np.zeros((len(algorithms), params.runs, params.iterations + 1, 2))
    for m, (algorithm, law) in enumerate(algorithms.values()):
        for r in range(params.runs):
            decisions[m, r] = _learned(task, algorithm, law, params, r)
    judge = Experiment(task=task, algorithm=algorithms["FOPG"][0], law=SHARP_LAW, hidden=None)
    flat = decisions.reshape(-1, 2)
    returns = _returns(judge, SHARP_LAW, flat).reshape(decisions.shape[:-1])
    angles, speeds = (np.linspace(*ends, params.grid) for ends in (ANGLES, SPEEDS))
    window = np.stack(np.meshgrid(angles, speeds, indexing="ij"), axis=-1).reshape(-1, 2)
    fine = np.linspace(*ANGLES, 20 * params.grid)
    line = np.column_stack([fine, np.full_like(fine, params.speed)])
    laws = {name: law for name, (_, law) in algorithms.items() if name != "ZOPG"}
    landscapes = [_returns(judge, law, window).reshape(params.grid, -1) for law in laws.values()]
    lines = [_returns(judge, law, line) for law in laws.values()]
    every = ("algorithm", "run", "iteration")
    return dataset(
        {
            "angle": (every, decisions[..., 0], "rad", "angle of the throw"),
            "speed": (every, decisions[..., 1], "m/s", "speed of the throw"),
            "exact_return": (every, returns, "m^2", "return under the exact law"),
            "landscape": (("law", "theta", "s"), landscapes, "m^2", "return"),
            "line": (("law", "along"), lines, "m^2", "return at one speed"),
        },
        {
            "algorithm": names,
            "law": list(laws),
            "theta": (angles, "rad", "angle"),
            "s": (speeds, "m/s", "speed"),
            "along": (fine, "rad", "angle"),
        },
    )


def parameters_of(task: Task, decision: np.ndarray) -> np.ndarray:
    """Return policy parameters (..., 2) for which the action is ``decision`` (..., 2), angle [rad] and speed [m/s]."""
    return np.arctanh((decision - task.mid_range) / task.half_range)


def _learned(task: Task, algorithm: Algorithm, law: ContactLaw, params: Params, run: int) -> np.ndarray:
    """Return the decisions (iterations + 1, 2), angle [rad] and speed [m/s], of one run."""
    seed = params.seed * 1000 + run
    experiment = Experiment(task=task, algorithm=algorithm, law=law, hidden=None, seed=seed, normalise=False)
    state = algorithm.begin(experiment)
    offset = params.spread * np.random.default_rng([params.seed, run]).uniform(-1, 1, 2)
    state["theta"] = parameters_of(task, np.array([params.angle, params.speed]) + offset)
    thetas = [state["theta"]]
    for k in range(params.iterations):
        state, _ = algorithm.iterate(experiment, state, k)
        thetas.append(state["theta"])
    return squash(task, np.array(thetas))


def _returns(experiment: Experiment, law: ContactLaw, decisions: np.ndarray) -> np.ndarray:
    """Compute the returns (n,) [m²] of decisions (n, 2) under ``law``, without noise."""
    task = experiment.task
    theta = parameters_of(task, decisions)
    x0 = task.reset(1, np.random.default_rng(0))
    return experiment.rollouts(task.horizon, law)(x0, theta).value


_SECTION_7_3 = "ABS, sec. 7.3"
"""Citation in the claims from the paper."""
_GOAL_RETURN = -0.01
"""Minimum return [m²] for which the ball counts as having reached the goal."""
_PROMINENCE = 1e-3
"""Minimum prominence of a local maximum, as a fraction of the range of values."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the learned throws and on the landscapes."""
    names = [str(name) for name in data["algorithm"].values]
    curves = {name: data["exact_return"].sel(algorithm=name).values for name in names}
    last = {name: curve[:, -1] for name, curve in curves.items()}
    areas = {name: mean_height(curve) for name, curve in curves.items()}
    barriers = [f"BS {mu:g}" for mu in MUS]
    smoothed = [*barriers, "ABS quartic", "ABS gaussian"]
    results = []
    for other in ("ZOPG", "FOPG"):
        gains = [mean_difference(last[name], last[other]) for name in barriers]
        faster = [mean_difference(areas[name], areas[other]) for name in barriers]
        results += [
            claim_gains(
                f"Barrier smoothing ends at a higher return than {other}",
                _SECTION_7_3,
                "final return above, 95 % over runs",
                MUS,
                gains,
            ),
            claim_gains(
                f"Barrier smoothing converges faster than {other}",
                _SECTION_7_3,
                "mean return over iterations above, 95 % over runs",
                MUS,
                faster,
            ),
        ]
    best = max(barriers, key=lambda name: last[name].mean())
    for name in ("ABS quartic", "ABS gaussian"):
        final_gain, mean_gain = mean_difference(last[name], last[best]), mean_difference(areas[name], areas[best])
        results.append(
            claim(f"Adaptive smoothing ({name.split()[1]}) does better than the best fixed one", _SECTION_7_3)
            .expected("final return and mean over iterations above, 95 % over runs")
            .measured(f"against {best}: final {final_gain}, mean {mean_gain}")
            .holds(final_gain.better and mean_gain.better, margin=smallest_margin((final_gain, mean_gain)))
        )
    shares = [float((last[name] > _GOAL_RETURN).mean()) for name in last]
    share_texts = ", ".join(f"{name} {share:.0%}" for name, share in zip(last, shares, strict=True))
    results.append(
        claim("Every method reaches the goal", "our check")
        .expected(f"return above {_GOAL_RETURN:g} m² in all runs, the best being 0")
        .measured(share_texts)
        .equals(min(shares), 1)
    )
    return [*results, *_of_landscapes(data, smoothed)]


def _of_landscapes(data: xr.Dataset, smoothed: list[str]) -> list[Claim]:
    from scipy.signal import find_peaks

    # Local maxima that stand out by more than a thousandth of the range of values.
    lines = {str(law): data["line"].sel(law=law).values for law in data["law"].values}
    peaks = {law: len(find_peaks(line, prominence=_PROMINENCE * np.ptp(line))[0]) for law, line in lines.items()}
    fewer = [peaks[name] < peaks["FOPG"] for name in smoothed]
    exact = data["landscape"].sel(law="FOPG")
    losses = []
    for name in smoothed:
        top = np.unravel_index(data["landscape"].sel(law=name).values.argmax(), exact.shape)
        losses.append(float(exact.values.max() - exact.values[top]))
    return [
        claim("The exact law's landscape has local maxima that smoothing removes", "our check")
        .expected(f"fewer along the angle than the exact law's {peaks['FOPG']}")
        .measured(f"{settings_text(smoothed, fewer)}: {', '.join(str(peaks[n]) for n in smoothed)}")
        .holds(fewer),
        claim("The best throw under a smoothed law is the best under the exact one", "our check")
        .expected(f"exact return of its best decision within {-_GOAL_RETURN:g} m² of the best")
        .measured(
            f"{settings_text(smoothed, np.array(losses) < -_GOAL_RETURN)}: less by {format_values(losses, '.2g')}"
        )
        .below(losses, -_GOAL_RETURN),
    ]
