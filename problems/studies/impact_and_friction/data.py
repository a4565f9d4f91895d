"""A6: derivatives of impact and of friction by barrier, adaptive and randomized smoothing."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import norm

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact
from problems.registry import get
from problems.studies.impact_and_friction.box_push import (
    cost_of_averaging,
    smoothed_box,
    softened_box,
)
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.study import StudyParams, quantity_of, setting

COUNTS = (10, 100, 1000)
BALL_MUS = (1e-4, 1e-3, 1e-2)
BOX_MUS = np.array([1 / 300, 1 / 30, 1 / 3])
"""mu of the box over h b²/m, b = friction h m g: of what its friction can hold."""
_NEAR = 2000
"""Places near the impact at which RS is asked whether it sees it."""
FINER = (1, 10, 100)
"""The exact ball's steps are h over these: RS at the step of BS, and as the step falls."""


class Params(StudyParams):
    """Parameters of A6; the paper gives no numbers and, for the box, no equations."""

    g: float = setting(9.81, "m/s^2", "gravity", above=0)
    q0: float = setting(1.0, "m", "height of the throw", above=0)
    h: float = setting(0.01, "s", "step of the ball, of the exact one the largest", above=0)
    sigma: float = setting(0.05, "m", "noise on q_x, and sigma of the adaptive law", above=0)
    friction: float = setting(0.5, "1", "Coulomb's coefficient of the box", above=0)
    h_box: float = setting(0.05, "s", "step of the box", above=0)
    sigma_box: float = setting(0.5, "N", "noise on the push", above=0)


def _velocity(params: Params, law: ContactLaw, h: float) -> np.ndarray:
    """Vertical velocity at every node of the throw, (N+1,); the ball has 1 kg and 1 m/s."""
    system = get("ball-bounce", h=h, g=params.g).system
    start = np.array([[0.0, params.q0, 1.0, 0.0]])
    steps = round(1.6 * np.sqrt(2 * params.q0 / params.g) / h)
    return SampledStep(law.close(system)).roll_out(start, np.zeros((1, 2)), steps)[0][0, :, 3]


def _impact(params: Params, rng: np.random.Generator) -> tuple[dict, dict]:
    """Derivative of v_y by q_x, where q_x equals the time, around the impact."""
    soft_laws = [*(Barrier(mu=mu) for mu in BALL_MUS), Adaptive(sigma=params.sigma)]
    soft = [np.diff(_velocity(params, law, params.h)) / params.h for law in soft_laws]
    impact = float(np.sqrt(2 * params.q0 / params.g))
    q = np.linspace(impact - 5 * params.sigma, impact + 5 * params.sigma, 201)
    averaged = np.empty((len(FINER), len(COUNTS), len(q)))
    quiet = np.empty((len(FINER), len(COUNTS)))
    # Within one sigma of the impact its average is not small: there RS has something to see.
    near = impact + params.sigma * np.linspace(-1, 1, _NEAR)
    for row, finer in enumerate(FINER):
        h = params.h / finer
        rates = np.diff(_velocity(params, Exact(), h)) / h
        for column, count in enumerate(COUNTS):
            averaged[row, column] = _averaged(rates, h, q, params.sigma, count, rng)
            seen = _averaged(rates, h, near, params.sigma, count, rng)
            quiet[row, column] = np.mean(seen <= 1e-6)
    jump = params.g * impact
    limit = -params.g * norm.sf((q - impact) / params.sigma) + jump * norm.pdf(
        q, impact, params.sigma
    )
    variables = {
        "impact_soft": quantity_of(("law", "q_mid"), soft, "1/s", "dv_y/dq_x, softened"),
        "impact_rs": quantity_of(("finer", "count", "q_x"), averaged, "1/s", "mean derivative, RS"),
        "quiet": quantity_of(
            ("finer", "count"),
            quiet,
            "1",
            "share of points within sigma of the impact where RS sees none",
        ),
        "impact_limit": quantity_of("q_x", limit, "1/s", "RS with infinitely many samples"),
        "jump": quantity_of((), jump, "m/s", "jump of v_y at the impact, ground truth"),
        "place": quantity_of((), impact, "m", "q_x of the impact"),
    }
    mid = params.h * (np.arange(len(soft[0])) + 0.5)
    return variables, {
        "finer": quantity_of("finer", FINER, "1", "h over the step of the exact ball"),
        "q_x": quantity_of("q_x", q, "m", "horizontal position"),
        "q_mid": quantity_of("q_mid", mid, "m", "horizontal position between two nodes"),
    }


def _averaged(
    rates: np.ndarray, h: float, q: np.ndarray, sigma: float, count: int, rng: np.random.Generator
) -> np.ndarray:
    """RS of the steps' ``rates``: means at places ``q`` (n,) over ``count`` samples, (n,)."""
    place = q[:, None] + sigma * rng.standard_normal((len(q), count))
    node = np.clip((place / h).astype(int), 0, len(rates) - 1)
    return rates[node].mean(axis=1)


def _push(params: Params, rng: np.random.Generator) -> tuple[dict, dict]:
    """Derivative of the box's next velocity by the push, from rest."""
    arguments = {"m": 1.0, "g": params.g, "friction": params.friction, "h": params.h_box}
    system = get("box-slide", **arguments).system
    u, rest = np.linspace(-10, 10, 81), np.zeros((1, 2))
    exact, barrier = SampledStep(Exact().close(system)), SampledStep(Barrier(mu=1.0).close(system))
    truth = exact(rest, u[:, None])
    mus = _box_mus(params)
    soft = [barrier(rest, u[:, None], mu=mu) for mu in mus]
    averaged, spread = [], []
    for count in COUNTS:
        # Off the two kinks the exact derivative is one of two constants, so a look-up is exact.
        push = u[:, None] + params.sigma_box * rng.standard_normal((len(u), count))
        slopes = np.interp(push, *_fine_slope(exact, rest))
        averaged.append(slopes.mean(axis=1))
        spread.append(slopes.std(axis=1, ddof=1).max() / np.sqrt(count))
    bound = params.friction * params.g
    limit, _ = smoothed_box(u, params.sigma_box, **arguments)
    at_step = barrier(rest, np.array([[bound]]), mu=mus).x_by_u[:, 1, 0]
    fine = np.linspace(0, 4 * bound, 2001)
    costs = [cost_of_averaging(fine, mu, **arguments) for mu in mus]
    closed, slope = zip(*(softened_box(u, mu, **arguments) for mu in mus), strict=True)
    found, by_push = [v.x_next[:, 1] for v in soft], [v.x_by_u[:, 1, 0] for v in soft]
    step = np.where(np.abs(u) > bound, params.h_box, 0.0)
    variables = {
        "push_exact": quantity_of("u", truth.x_by_u[:, 1, 0], "m/(N s)", "dv+/du, exact"),
        "push_soft": quantity_of(("box_mu", "u"), by_push, "m/(N s)", "dv+/du, barrier"),
        "push_rs": quantity_of(("count", "u"), averaged, "m/(N s)", "dv+/du, RS"),
        "push_limit": quantity_of("u", limit, "m/(N s)", "RS with infinitely many samples"),
        "push_error": quantity_of("count", spread, "m/(N s)", "largest standard error of RS"),
        "push_step": quantity_of("u", step, "m/(N s)", "h/m where |u| > friction m g, else 0"),
        "at_step": quantity_of("box_mu", at_step / params.h_box, "1",
                               "dv+/du of the barrier at u = friction m g, over h/m"),
        **{f"cost_{name}": quantity_of("box_mu", [getattr(c, name) for c in costs], unit, meaning)
           for name, unit, meaning in (
               ("bias", "m/(N s)", "rms error of the barrier's slope"),
               ("sigma", "N", "noise at which RS has that bias"),
               ("single", "1", "rms error of one exact solve at that noise, over that bias"),
               ("needed", "1", "exact solves for an error within a tenth of the barrier's"))},
        "push_residual": quantity_of("box_mu", np.abs(np.subtract(found, closed)).max(axis=1),
                                     "m/s", "v+ less the closed form"),
        "slope_residual": quantity_of("box_mu", np.abs(np.subtract(by_push, slope)).max(axis=1),
                                      "m/(N s)", "dv+/du less the closed form"),
    }  # fmt: skip
    return variables, {"u": quantity_of("u", u, "N", "push")}


def _box_mus(params: Params) -> np.ndarray:
    return BOX_MUS * params.h_box * (params.friction * params.h_box * params.g) ** 2


def _fine_slope(step: SampledStep, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact dv+/du on a fine grid of pushes."""
    fine = np.linspace(-13, 13, 521)
    return fine, step(rest, fine[:, None]).x_by_u[:, 1, 0]


def run(params: Params) -> xr.Dataset:
    """Both panels of fig. 6."""
    rng = np.random.default_rng(params.seed)
    impact, places = _impact(params, rng)
    push, pushes = _push(params, rng)
    return xr.Dataset(
        {**impact, **push},
        {
            **places,
            **pushes,
            "count": quantity_of("count", COUNTS, "1", "samples"),
            "law": ("law", [*(f"mu = {mu:g} N s m" for mu in BALL_MUS), "adaptive"]),
            "box_mu": quantity_of(
                "box_mu", _box_mus(params), "N s m", "central-path parameter of the box"
            ),
        },
    )
