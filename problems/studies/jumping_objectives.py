"""P1: three simple systems whose objectives jump, with smoothed objectives and gradient estimates.

The systems are those of Suh et al. 2022, fig. 1: a dropped ball, a throw past a wall, a pivoted bar.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import xarray as xr
from scipy.stats import norm

from dynamics.contact.interior_point import exact_scalar_solution
from dynamics.systems import ParameterTable, Signal
from ocp.gradients.objective import StaticObjective
from problems.studies.shared.decision_sweep import sweep_decision
from problems.studies.study import CODE, Claim, StudyParams, claim, dataset, format_values, setting

NOTES = (
    "All three are minimised: minus height, minus squared distance, minus squared angular velocity.",
    "The authors' code draws panel C from the surrogate -sin²(theta) up to 45 degrees; here the"
    " ball hits a bar, pivoted in its middle, in a plastic frictionless impact.",
)


class Params(StudyParams):
    """Parameters of study P1 from the authors' code, and further ones for physical models of drop and pivot."""

    g: float = setting(9.81, "m/s^2", "gravity", CODE, above=0)
    step_height: float = setting(1.0, "m", "height of the step", CODE, above=0)
    start: float = setting(2.0, "m", "height of the drop", above=0)
    sigma_drop: float = setting(0.3, "m", "noise on the drop", CODE, above=0)
    v0_throw: float = setting(1.0, "m/s", "speed of the throw", CODE, above=0)
    wall: float = setting(0.06, "m", "distance of the wall", CODE, above=0)
    wall_height: float = setting(0.02, "m", "height of the wall", CODE, above=0)
    sigma_throw: float = setting(0.07, "rad", "noise on the throw", CODE, above=0)
    v0_pivot: float = setting(2.0, "m/s", "speed towards the bar", CODE, above=0)
    bar: float = setting(0.7, "m", "distance of the pivot", CODE, above=0)
    length: float = setting(0.5, "m", "bar from its pivot to a tip", CODE, above=0)
    inertia: float = setting(1.0, "kg m^2", "inertia of the bar", CODE, above=0)
    mass: float = setting(1.0, "kg", "mass of the ball", CODE, above=0)
    sigma_pivot: float = setting(0.05, "rad", "noise on the angle", CODE, above=0)
    points: int = setting(121, "1", "decisions", least=20)
    n_samples: int = setting(1000, "1", "samples of each estimate", CODE, least=10)


def run(params: Params) -> xr.Dataset:
    """Compute objective, smoothed objective and gradient estimates over the decision of each system."""
    systems = {
        "drop": (drop_ball(params.step_height, params.start, params.g), np.pi / 2, "m", "m"),
        "throw": (throw_wall(params.v0_throw, params.wall, params.wall_height, params.g), np.pi / 2, "m^2", "rad"),
        "pivot": (
            hit_bar(params.v0_pivot, params.bar, params.length, params.mass, params.inertia),
            np.pi / 3,
            "1/s^2",
            "rad",
        ),
    }
    variables, coordinates = {}, {}
    for index, (name, (objective, reach, unit, per)) in enumerate(systems.items()):
        lowest = 0.0 if name == "throw" else -reach
        theta = np.linspace(lowest, reach, params.points)
        fine = np.linspace(lowest, reach, 100 * (params.points - 1) + 1)
        sigma = getattr(params, f"sigma_{name}")
        estimates = sweep_decision(objective, theta, sigma, params.n_samples, params.seed + 1000 * index)
        thetas_name, dense = f"theta_{name}", f"fine_{name}"
        slope = f"{unit}/{per}"
        variables |= {
            f"f_{name}": (dense, objective.costs(fine[:, None]), unit, "objective"),
            f"F_{name}": (thetas_name, estimates["F"], unit, "smoothed objective"),
            f"slope_{name}": (thetas_name, estimates["slope"], slope, "its derivative"),
            f"first_{name}": ((thetas_name, "moment"), estimates["first"], slope, "FoBG"),
            f"zeroth_{name}": ((thetas_name, "moment"), estimates["zeroth"], slope, "ZoBG"),
        }
        coordinates |= {
            thetas_name: (theta, per, objective.decision[0].description),
            dense: (fine, per, objective.decision[0].description),
        }
    return dataset(variables, {**coordinates, "moment": ["mean", "standard error"]})


def drop_ball(step_height: float, start: float, g: float) -> StaticObjective:
    """Build the objective of a ball dropped at x = theta over a step: minus its final height, -y [m].

    The ball falls freely until it would be below both levels; the inelastic landing is the exact law
    ``0 <= lam ⟂ y - ground + lam >= 0`` with ``ground = step_height`` for theta >= 0, else 0.
    """
    theta = ca.SX.sym("theta")
    long = np.sqrt(4 * start / g)
    ground = ca.if_else(theta >= 0, step_height, 0.0)
    free = start - g * long**2 / 2
    y = free + exact_scalar_solution(free - ground, ca.SX(1.0))
    return _objective("drop", theta, -y, "m", "where the ball is dropped")


def throw_wall(v0: float, distance: float, height: float, g: float) -> StaticObjective:
    """Build the objective of a ball thrown at angle theta at a wall: minus its squared distance, -x² [m²].

    The ball lands at ``v0² sin(2 theta)/g`` unless it hits the wall below its top; after that
    inelastic impact it falls down along the wall.
    """
    theta = ca.SX.sym("theta")
    flight = 2 * v0**2 * ca.sin(theta) * ca.cos(theta) / g
    cosine = ca.if_else(ca.cos(theta) > 1e-9, ca.cos(theta), 1e-9)
    at_wall = distance * ca.sin(theta) / cosine - g * distance**2 / (2 * v0**2 * cosine**2)
    stopped = ca.logic_and(flight > distance, at_wall <= height)
    x = ca.if_else(stopped, distance, flight)
    return _objective("throw-wall", theta, -(x**2), "rad", "angle of the throw")


def hit_bar(v0: float, distance: float, length: float, mass: float, inertia: float) -> StaticObjective:
    """Build the objective of a ball that hits a bar pivoted at (distance, 0): -omega² [1/s²].

    The ball flies straight at angle theta and hits the bar, which extends ``length`` to both
    sides, at the lever arm ``r = distance tan(theta)``. The frictionless plastic impact is the exact
    law ``0 <= lam ⟂ -v_x + (1/mass + r²/inertia) lam >= 0``, omega = r lam/inertia. Beyond the tip
    the ball misses the bar, omega = 0.
    """
    theta = ca.SX.sym("theta")
    arm = distance * ca.tan(theta)
    approach = v0 * ca.cos(theta)
    lam = exact_scalar_solution(-approach, 1 / mass + arm**2 / inertia)
    omega = ca.if_else(ca.fabs(arm) <= length, arm * lam / inertia, 0.0)
    return _objective("pivot", theta, -(omega**2), "rad", "angle of the throw")


def _objective(name: str, theta: ca.SX, cost: ca.SX, unit: str, meaning: str) -> StaticObjective:
    decision = (Signal("theta", unit, meaning),)
    return StaticObjective(name, decision, theta, cost, np.zeros(1), ParameterTable())


NAMES = ("drop", "throw", "pivot")
"""Names of the three systems of fig. 1."""


def jump_decisions(data: xr.Dataset, name: str) -> np.ndarray:
    """Return the decisions at which the objective f jumps by more than a tenth of its range."""
    f, theta = data[f"f_{name}"].values, data[f"fine_{name}"].values
    return theta[:-1][np.abs(np.diff(f)) > 0.1 * np.ptp(f)]


def _bias(data: xr.Dataset, name: str) -> float:
    """Return the largest error of the first-order gradient, divided by the largest slope."""
    slope = data[f"slope_{name}"].values
    errors = np.abs(data[f"first_{name}"].values[:, 0] - slope)
    return float(errors.max() / np.abs(slope).max())


def _steps(data: xr.Dataset, name: str) -> float:
    """Return the largest step of the smoothed F on its grid, divided by ``spacing range(f)/(sqrt(2 pi) sigma)``."""
    step = np.abs(np.diff(data[f"F_{name}"].values)).max()
    spacing = float(data[f"theta_{name}"][1] - data[f"theta_{name}"][0])
    steepest = np.ptp(data[f"f_{name}"].values) * norm.pdf(0, 0, data.attrs[f"sigma_{name}"])
    return float(step / (steepest * spacing))


def _scatter(data: xr.Dataset, name: str) -> tuple[float, float, int]:
    """Return sqrt(n) times the mean, the root mean square, and the number n of scores at steep slopes.

    A score is the error of the zeroth-order gradient divided by its standard error.
    """
    estimate, slope = data[f"zeroth_{name}"].values, data[f"slope_{name}"].values
    # Where the slope is small, too few samples cross the jump to estimate a standard error.
    steep = np.abs(slope) > 0.3 * np.abs(slope).max()
    score = (estimate[steep, 0] - slope[steep]) / estimate[steep, 1]
    return float(score.mean() * np.sqrt(score.size)), float(np.sqrt(np.mean(score**2))), score.size


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Suh et al. 2022, fig. 1 and sec. III-A."""
    biases = [_bias(data, name) for name in NAMES]
    offset, scatter, number = np.transpose([_scatter(data, name) for name in NAMES])
    is_unbiased = np.all(np.abs(scatter - 1) < 5 / np.sqrt(2 * number)) and np.all(np.abs(offset) < 5)
    reach = data.attrs["v0_throw"] ** 2 / data.attrs["g"]
    flat = float(np.abs(data["first_drop"].values[:, 0]).max())
    throw, tip = jump_decisions(data, "throw"), jump_decisions(data, "pivot")
    expected = np.arctan(data.attrs["length"] / data.attrs["bar"])
    best = int(data["f_throw"].values.argmin())
    raw = [float(np.abs(np.diff(data[f"f_{name}"].values)).max() / np.ptp(data[f"f_{name}"].values)) for name in NAMES]
    smooth = [_steps(data, name) for name in NAMES]
    angle = float(data["fine_throw"][best])

    return [
        claim("The objectives of all three systems jump", "Pathologies, sec. I, fig. 1")
        .expected("a jump of 10 % or more")
        .measured(f"{format_values(raw, '.2f')} of the range within one fine step")
        .above(raw, 0.1),
        claim("Randomized smoothing makes them continuous", "our check")
        .expected("steps no larger than range(f) spacing/(sqrt(2 pi) sigma)")
        .measured(f"{format_values(smooth, '.2f')} of it at most")
        .below(smooth, 1.05),
        claim("The dropped ball has no gradient almost everywhere", "our check")
        .expected("FoBG = 0")
        .measured(f"largest |FoBG| {flat:g} m/m")
        .equals(flat, 0),
        claim("FoBG is biased where the objective jumps", "Pathologies, sec. III-A")
        .expected("error beyond its interval")
        .measured(f"error {format_values(biases, '.2f')} of the largest slope")
        .above(biases, 0.2),
        claim("ZoBG is unbiased", "Pathologies, sec. III-A")
        .expected("errors of 1 standard error, mean 0")
        .measured(f"{format_values(scatter, '.2f')} rms, mean {format_values(offset, '.2f')} of its own standard error")
        .holds(is_unbiased),
        claim("The throw's best angle is pi/4, away from the wall's jumps", "closed form")
        .expected(f"{np.pi / 4:.4f} rad, {-(reach**2):.5f} m²")
        .measured(f"{angle:.4f} rad, {float(data['f_throw'][best]):.5f} m²; jumps at {format_values(throw, '.3f')} rad")
        .holds(abs(angle - np.pi / 4) < 0.002, np.abs(throw - angle) > 0.01),
        claim("Momentum transfer ends where the ball clears the tip", "closed form")
        .expected(f"+-{expected:.4f} rad")
        .measured(f"{format_values(tip, '+.4f')} rad")
        .holds(len(tip) == 2 and np.allclose(np.abs(tip), expected, atol=1e-3)),
    ]
