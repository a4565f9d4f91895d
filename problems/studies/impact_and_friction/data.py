"""A6: derivatives of an impact and of friction under barrier, adaptive and randomized smoothing (RS)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.stats import norm

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact
from problems.registry import get
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.study import StudyParams, dataset, setting


def softened_box(
    u: np.ndarray, mu: float, m: float, g: float, friction: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a box's next velocity [m/s] from rest under pushes u [N], and its derivative by u [m/(N s)], (n,) each.

    A barrier on both faces of |f| <= b = friction h m g, with f the friction impulse, gives ``v+ = r(f) = -(2 mu/h)
    f/(b² - f²)`` with ``m v+ = h u + f``, which has a single root f; mu is in N s m. The derivative is ``(h/m) c/(1 +
    c)``, ``c = -m r'(f) = (2 m mu/h) (b² + f²)/(b² - f²)²``; it tends to 0 in stick and to h/m in slip.
    """
    b = friction * h * m * g

    def root(push: float) -> float:
        def relation(f: float) -> float:
            return (h * push + f) * (b**2 - f**2) / m + 2 * mu / h * f

        return float(brentq(relation, -b, b, xtol=1e-15))  # pyright: ignore[reportArgumentType]

    f = np.array([root(push) for push in u])
    c = 2 * m * mu / h * (b**2 + f**2) / (b**2 - f**2) ** 2
    return (h * u + f) / m, h / m * c / (1 + c)


def smoothed_box(
    u: np.ndarray, sigma: float, m: float, g: float, friction: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance, (n,) each, of a box's exact dv+/du [m/(N s)] at pushes N(u, sigma²).

    The exact derivative is h/m if |u| > friction m g, else 0, so that mean and variance depend only on
    the probability of slip.
    """
    bound = friction * m * g
    p = norm.sf((bound - u) / sigma) + norm.sf((bound + u) / sigma)
    return h / m * p, (h / m) ** 2 * p * (1 - p)


@dataclass(frozen=True)
class Cost:
    """Number of exact solves that replace one softened solve of the box at equal bias, and related errors.

    ``bias`` [m/(N s)]: root mean square, over the pushes, of the softened slope minus the exact one;
    ``sigma`` [N]: noise for which the averaged exact slope has the same bias; ``single``: error of one
    exact solve over that bias; ``needed``: number of exact solves whose average has an error of at most 1.1 times the
    bias.
    """

    bias: float
    sigma: float
    single: float
    needed: float


def cost_of_averaging(u: np.ndarray, mu: float, **box: float) -> Cost:
    """Compare barrier and randomized smoothing of the slope on a fine grid of pushes ``u`` [N] past both jumps."""
    exact = np.where(np.abs(u) > box["friction"] * box["m"] * box["g"], box["h"] / box["m"], 0.0)

    def root_mean_square(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    bias = root_mean_square(softened_box(u, mu, **box)[1] - exact)

    def excess(sigma: float) -> float:
        return root_mean_square(smoothed_box(u, sigma, **box)[0] - exact) - bias

    # For sigma far below the grid's spacing RS gives the exact slope; far above its length it gives h/m everywhere.
    smallest_sigma, largest_sigma = 1e-2 * float(u[1] - u[0]), 1e6 * float(np.ptp(u))
    sigma = float(brentq(excess, smallest_sigma, largest_sigma))  # pyright: ignore[reportArgumentType]
    variance = float(np.mean(smoothed_box(u, sigma, **box)[1]))
    return Cost(bias, sigma, np.sqrt(1 + variance / bias**2), variance / (0.21 * bias**2))


COUNTS = (10, 100, 1000)
"""Numbers of samples in an average of randomized smoothing."""
BALL_MUS = (1e-4, 1e-3, 1e-2)
"""Central-path parameters of the ball's barrier laws [N s m]."""
BOX_MUS = np.array([1 / 300, 1 / 30, 1 / 3])
"""Central-path parameters of the box divided by h b²/m, where b = friction h m g is the maximum friction impulse."""
_POINTS_NEAR_IMPACT = 2000
"""Number of positions, at most sigma from the impact, at which randomized smoothing is evaluated."""
FINER = (1, 10, 100)
"""Ratios of the barrier law's step size to the step size of the exact rollouts that are averaged."""


class Params(StudyParams):
    """Parameters of study A6; all defaults are our choice, since the paper gives no numbers."""

    g: float = setting(9.81, "m/s^2", "gravity", above=0)
    q0: float = setting(1.0, "m", "height of the throw", above=0)
    h: float = setting(0.01, "s", "step of the ball, of the exact one the largest", above=0)
    sigma: float = setting(0.05, "m", "noise on q_x, and sigma of the adaptive law", above=0)
    friction: float = setting(0.5, "1", "Coulomb's coefficient of the box", above=0)
    h_box: float = setting(0.05, "s", "step of the box", above=0)
    sigma_box: float = setting(0.5, "N", "noise on the push", above=0)


def _velocity(params: Params, law: ContactLaw, h: float) -> np.ndarray:
    """Return the vertical velocity (N+1,) of a ball of 1 kg, thrown horizontally at 1 m/s."""
    system = get("ball-bounce", h=h, g=params.g).system
    start = np.array([[0.0, params.q0, 1.0, 0.0]])
    steps = round(1.6 * np.sqrt(2 * params.q0 / params.g) / h)
    return SampledStep(law.close(system)).roll_out(start, np.zeros((1, 2)), steps)[0][0, :, 3]


def _impact(params: Params, rng: np.random.Generator) -> tuple[dict, dict]:
    """Compute the derivative of v_y with respect to q_x near the impact; q_x [m] equals the time [s]."""
    soft_laws = [*(Barrier(mu=mu) for mu in BALL_MUS), Adaptive(sigma=params.sigma)]
    soft = [np.diff(_velocity(params, law, params.h)) / params.h for law in soft_laws]
    impact = float(np.sqrt(2 * params.q0 / params.g))
    q = np.linspace(impact - 5 * params.sigma, impact + 5 * params.sigma, 201)
    averaged = np.empty((len(FINER), len(COUNTS), len(q)))
    quiet = np.empty((len(FINER), len(COUNTS)))
    # At most sigma from the impact the expected average is not small, so that RS should show the impact.
    near_impact = impact + params.sigma * np.linspace(-1, 1, _POINTS_NEAR_IMPACT)
    for row, finer in enumerate(FINER):
        h = params.h / finer
        rates = np.diff(_velocity(params, Exact(), h)) / h
        for column, count in enumerate(COUNTS):
            averaged[row, column] = _averaged(rates, h, q, params.sigma, count, rng)
            near_slopes = _averaged(rates, h, near_impact, params.sigma, count, rng)
            quiet[row, column] = np.mean(near_slopes <= 1e-6)
    jump = params.g * impact
    limit = -params.g * norm.sf((q - impact) / params.sigma) + jump * norm.pdf(q, impact, params.sigma)
    variables = {
        "impact_soft": (("law", "q_mid"), soft, "1/s", "dv_y/dq_x, softened"),
        "impact_rs": (("finer", "count", "q_x"), averaged, "1/s", "mean derivative, RS"),
        "quiet": (("finer", "count"), quiet, "1", "share of points within sigma of the impact where RS sees none"),
        "impact_limit": ("q_x", limit, "1/s", "RS with infinitely many samples"),
        "jump": ((), jump, "m/s", "jump of v_y at the impact, ground truth"),
        "place": ((), impact, "m", "q_x of the impact"),
    }
    mid = params.h * (np.arange(len(soft[0])) + 0.5)
    return variables, {
        "finer": (FINER, "1", "h over the step of the exact ball"),
        "q_x": (q, "m", "horizontal position"),
        "q_mid": (mid, "m", "horizontal position between two nodes"),
    }


def _averaged(
    rates: np.ndarray, h: float, q: np.ndarray, sigma: float, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Return means (n,) of ``rates``, one for each step ``h``, at ``count`` random positions near each ``q``."""
    positions = q[:, None] + sigma * rng.standard_normal((len(q), count))
    node = np.clip((positions / h).astype(int), 0, len(rates) - 1)
    return rates[node].mean(axis=1)


def _push(params: Params, rng: np.random.Generator) -> tuple[dict, dict]:
    """Compute the derivative of the next velocity of a box at rest with respect to the push."""
    arguments = {"m": 1.0, "g": params.g, "friction": params.friction, "h": params.h_box}
    system = get("box-slide", **arguments).system
    u, x_rest = np.linspace(-10, 10, 81), np.zeros((1, 2))
    exact, barrier = SampledStep(Exact().close(system)), SampledStep(Barrier(mu=1.0).close(system))
    truth = exact(x_rest, u[:, None])
    mus = _box_mus(params)
    soft = [barrier(x_rest, u[:, None], mu=mu) for mu in mus]
    averaged, spread, fine = [], [], np.linspace(-13, 13, 521)
    exact_slopes = exact(x_rest, fine[:, None]).x_by_u[:, 1, 0]
    for count in COUNTS:
        # Except at the two kinks the exact derivative is one of two constants, so that interpolation is exact.
        push = u[:, None] + params.sigma_box * rng.standard_normal((len(u), count))
        slopes = np.interp(push, fine, exact_slopes)
        averaged.append(slopes.mean(axis=1))
        spread.append(slopes.std(axis=1, ddof=1).max() / np.sqrt(count))
    bound = params.friction * params.g
    limit, _ = smoothed_box(u, params.sigma_box, **arguments)
    at_step = barrier(x_rest, np.array([[bound]]), mu=mus).x_by_u[:, 1, 0]
    fine = np.linspace(0, 4 * bound, 2001)
    costs = [cost_of_averaging(fine, mu, **arguments) for mu in mus]
    closed, slope = zip(*(softened_box(u, mu, **arguments) for mu in mus), strict=True)
    velocities, by_push = [v.x_next[:, 1] for v in soft], [v.x_by_u[:, 1, 0] for v in soft]
    step = np.where(np.abs(u) > bound, params.h_box, 0.0)
    variables = {
        "push_exact": ("u", truth.x_by_u[:, 1, 0], "m/(N s)", "dv+/du, exact"),
        "push_soft": (("box_mu", "u"), by_push, "m/(N s)", "dv+/du, barrier"),
        "push_rs": (("count", "u"), averaged, "m/(N s)", "dv+/du, RS"),
        "push_limit": ("u", limit, "m/(N s)", "RS with infinitely many samples"),
        "push_error": ("count", spread, "m/(N s)", "largest standard error of RS"),
        "push_step": ("u", step, "m/(N s)", "h/m where |u| > friction m g, else 0"),
        "at_step": ("box_mu", at_step / params.h_box, "1", "dv+/du of the barrier at u = friction m g, over h/m"),
        **{
            f"cost_{name}": ("box_mu", [getattr(c, name) for c in costs], unit, meaning)
            for name, unit, meaning in (
                ("bias", "m/(N s)", "rms error of the barrier's slope"),
                ("sigma", "N", "noise at which RS has that bias"),
                ("single", "1", "rms error of one exact solve at that noise, over that bias"),
                ("needed", "1", "exact solves for an error within a tenth of the barrier's"),
            )
        },
        "push_residual": (
            "box_mu",
            np.abs(np.subtract(velocities, closed)).max(axis=1),
            "m/s",
            "v+ less the closed form",
        ),
        "slope_residual": (
            "box_mu",
            np.abs(np.subtract(by_push, slope)).max(axis=1),
            "m/(N s)",
            "dv+/du less the closed form",
        ),
    }
    return variables, {"u": (u, "N", "push")}


def _box_mus(params: Params) -> np.ndarray:
    return BOX_MUS * params.h_box * (params.friction * params.h_box * params.g) ** 2


def run(params: Params) -> xr.Dataset:
    """Compute both panels of fig. 6 of Zhang et al. 2023."""
    rng = np.random.default_rng(params.seed)
    impact, coordinates = _impact(params, rng)
    push, pushes = _push(params, rng)
    return dataset(
        {**impact, **push},
        {
            **coordinates,
            **pushes,
            "count": (COUNTS, "1", "samples"),
            "law": [*(f"mu = {mu:g} N s m" for mu in BALL_MUS), "adaptive"],
            "box_mu": (_box_mus(params), "N s m", "central-path parameter of the box"),
        },
    )
