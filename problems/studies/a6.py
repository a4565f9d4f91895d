"""A6: derivatives of impact and of friction by barrier, adaptive and randomized smoothing."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import norm

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact
from problems.registry import get
from problems.spec import Citation
from problems.studies.box_push import softened_box
from problems.studies.sampled_step import SampledStep
from problems.studies.study import CHOICE, Claim, Study, StudyParams, quantity_of, setting

COUNTS = (10, 100, 1000)
BALL_MUS = (1e-4, 1e-3, 1e-2)
BOX_MUS = (1e-5, 1e-4, 1e-3)


class Params(StudyParams):
    """Parameters of A6; the paper gives no numbers and, for the box, no equations."""

    g: float = setting(9.81, "m/s^2", "gravity", CHOICE, above=0)
    q0: float = setting(1.0, "m", "height of the throw", CHOICE, above=0)
    h: float = setting(0.01, "s", "step of the softened ball", CHOICE, above=0)
    h_exact: float = setting(1e-4, "s", "step of the exact ball", CHOICE, above=0)
    sigma: float = setting(0.05, "m", "noise on q_x, and sigma of the adaptive law", CHOICE,
                           above=0)  # fmt: skip
    friction: float = setting(0.5, "1", "Coulomb's coefficient of the box", CHOICE, above=0)
    h_box: float = setting(0.05, "s", "step of the box", CHOICE, above=0)
    sigma_box: float = setting(0.5, "N", "noise on the push", CHOICE, above=0)


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
    rates = np.diff(_velocity(params, Exact(), params.h_exact)) / params.h_exact
    impact = float(np.sqrt(2 * params.q0 / params.g))
    q = np.linspace(impact - 5 * params.sigma, impact + 5 * params.sigma, 201)
    averaged = []
    for count in COUNTS:
        place = q[:, None] + params.sigma * rng.standard_normal((len(q), count))
        node = np.clip((place / params.h_exact).astype(int), 0, len(rates) - 1)
        averaged.append(rates[node].mean(axis=1))
    jump = params.g * impact
    limit = -params.g * norm.sf((q - impact) / params.sigma) + jump * norm.pdf(
        q, impact, params.sigma
    )
    variables = {
        "impact_soft": quantity_of(("law", "q_mid"), soft, "1/s", "dv_y/dq_x, softened"),
        "impact_rs": quantity_of(("count", "q_x"), averaged, "1/s", "mean derivative, RS"),
        "impact_limit": quantity_of("q_x", limit, "1/s", "RS with infinitely many samples"),
        "jump": quantity_of((), jump, "m/s", "jump of v_y at the impact, ground truth"),
        "place": quantity_of((), impact, "m", "q_x of the impact"),
    }
    mid = params.h * (np.arange(len(soft[0])) + 0.5)
    return variables, {
        "q_x": quantity_of("q_x", q, "m", "horizontal position"),
        "q_mid": quantity_of("q_mid", mid, "m", "horizontal position between two nodes"),
    }


def _push(params: Params, rng: np.random.Generator) -> tuple[dict, dict]:
    """Derivative of the box's next velocity by the push, from rest."""
    arguments = {"m": 1.0, "g": params.g, "friction": params.friction, "h": params.h_box}
    system = get("box-slide", **arguments).system
    u, rest = np.linspace(-10, 10, 81), np.zeros((1, 2))
    exact, barrier = SampledStep(Exact().close(system)), SampledStep(Barrier(mu=1.0).close(system))
    truth = exact(rest, u[:, None])
    soft = [barrier(rest, u[:, None], contact__mu=mu) for mu in BOX_MUS]
    averaged, spread = [], []
    for count in COUNTS:
        # Off the two kinks the exact derivative is one of two constants, so a look-up is exact.
        push = u[:, None] + params.sigma_box * rng.standard_normal((len(u), count))
        slopes = np.interp(push, *_fine_slope(exact, rest))
        averaged.append(slopes.mean(axis=1))
        spread.append(slopes.std(axis=1, ddof=1).max() / np.sqrt(count))
    bound = params.friction * params.g
    slips = norm.sf((bound - u) / params.sigma_box) + norm.sf((bound + u) / params.sigma_box)
    limit = params.h_box * slips
    closed, slope = zip(*(softened_box(u, mu, **arguments) for mu in BOX_MUS), strict=True)
    found, by_push = [v.x_next[:, 1] for v in soft], [v.x_by_u[:, 1, 0] for v in soft]
    step = np.where(np.abs(u) > bound, params.h_box, 0.0)
    variables = {
        "push_exact": quantity_of("u", truth.x_by_u[:, 1, 0], "m/(N s)", "dv+/du, exact"),
        "push_soft": quantity_of(("box_mu", "u"), by_push, "m/(N s)", "dv+/du, barrier"),
        "push_rs": quantity_of(("count", "u"), averaged, "m/(N s)", "dv+/du, RS"),
        "push_limit": quantity_of("u", limit, "m/(N s)", "RS with infinitely many samples"),
        "push_error": quantity_of("count", spread, "m/(N s)", "largest standard error of RS"),
        "push_step": quantity_of("u", step, "m/(N s)", "h/m where |u| > friction m g, else 0"),
        "push_residual": quantity_of("box_mu", np.abs(np.subtract(found, closed)).max(axis=1),
                                     "m/s", "v+ less the closed form"),
        "slope_residual": quantity_of("box_mu", np.abs(np.subtract(by_push, slope)).max(axis=1),
                                      "m/(N s)", "dv+/du less the closed form"),
    }  # fmt: skip
    return variables, {"u": quantity_of("u", u, "N", "push")}


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
            "box_mu": quantity_of("box_mu", BOX_MUS, "N s m", "central-path parameter of the box"),
        },
    )


def claims(data: xr.Dataset) -> list[Claim]:
    """What fig. 6 says."""
    g, h, jump = data.attrs["g"], data.attrs["h"], float(data["jump"])
    few, limit = data["impact_rs"].values[1], data["impact_limit"].values
    before = data["q_x"].values < float(data["place"]) - 3 * data.attrs["sigma"]
    quiet = float(np.mean(np.abs(data["impact_rs"].values[0]) <= g + 1e-6))
    area = (data["impact_soft"].values.clip(min=0)).sum(axis=1) * h
    peak = data["impact_soft"].values.max(axis=1)
    rs, error = data["push_rs"].values, data["push_error"].values
    needed = COUNTS[1] * (error[1] / (0.01 * data.attrs["h_box"])) ** 2
    noise = np.abs(rs - data["push_limit"].values).max(axis=1)
    bend = np.abs(np.diff(data["push_soft"].values, 2, axis=1)).max()
    rough = np.abs(np.diff(rs[0], 2)).max()
    residual, slope = float(data["push_residual"].max()), float(data["slope_residual"].max())
    off = np.abs(data["push_soft"].values - data["push_exact"].values)
    stepped = float(np.abs(data["push_exact"] - data["push_step"]).max())
    mid = len(data["u"]) // 2
    mus = " m/(N s) at mu = " + ", ".join(f"{mu:g}" for mu in BOX_MUS)
    return [
        Claim("The RS gradient of an impact is constant, with a large bias", "ABS, fig. 6a",
              f"-g or 0, not up to {limit.max():.1f} 1/s", f"{quiet:.1%} of the points at 10"
              f" samples; before the impact {few[before].mean():.2f} 1/s", quiet > 0.8),
        Claim("The BS gradient approximates the impulse at contact", "ABS, fig. 6a",
              f"area {jump:.2f} m/s", ", ".join(f"{a:.2f}" for a in area[:-1])
              + " m/s at mu = " + ", ".join(f"{mu:g}" for mu in BALL_MUS),
              bool(abs(area[0] / jump - 1) < 0.05)),
        Claim("So does the adaptive law's", "ABS, fig. 6a", f"area {jump:.2f} m/s",
              f"{area[-1]:.2f} m/s, peak {peak[-1]:.0f} 1/s",
              bool(abs(area[-1] / jump - 1) < 0.05)),
        Claim("RS gradients of friction are noisy", "ABS, fig. 6b", "error ~ 1/sqrt(N)",
              ", ".join(f"{e:.4f}" for e in noise) + " m/(N s) at N = "
              + ", ".join(str(c) for c in COUNTS), bool(np.all(np.diff(error) < 0))),
        Claim("BS gradients of friction are smooth", "ABS, fig. 6b",
              "second difference far below RS", f"{bend:.1e} against {rough:.1e} m/(N s)",
              bool(bend < 0.5 * rough)),
        Claim("RS is costlier than BS", "ABS, fig. 6b", "more than 1 solve a point",
              f"{needed:.0f} exact solves for a standard error of 1 % of h/m", needed > 10),
        Claim("The exact slope is a step: 0 in stick, h/m in slip", "closed form",
              "0, and h/m for |u| > friction m g", f"off by {stepped:.1e} m/(N s)",
              stepped < 1e-5),
        Claim("A barrier on both faces gives v+ = -(2 mu/h) f/(b² - f²)", "closed form", "0 m/s",
              f"{residual:.1e} m/s", residual < 1e-9),
        Claim("Its slope is (h/m) c/(1 + c), c = (2 m mu/h) (b² + f²)/(b² - f²)²", "closed form",
              "0 m/(N s)", f"{slope:.1e} m/(N s)", slope < 1e-8),
        Claim("BS of friction tends to the exact slope in stick", "closed form",
              "0 m/(N s) at u = 0", ", ".join(f"{o:.1e}" for o in off[:, mid]) + mus,
              bool(np.all(off[:-1, mid] < off[1:, mid] / 5))),
        Claim("Where the exact slope steps, BS is off by a share that does not vanish",
              "our check", "about half of h/m beside |u| = friction m g",
              ", ".join(f"{o:.2g}" for o in off.max(axis=1) / data.attrs["h_box"]) + " of h/m",
              bool(np.all(off.max(axis=1) > 0.2 * data.attrs["h_box"]))),
    ]  # fmt: skip


study = Study(
    id="A6",
    title="Smoothing an impact and smoothing friction",
    citation=Citation("zhang2023adaptive", "Fig. 6"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "RS averages the derivative that exists almost everywhere, as automatic differentiation"
        " gives it; only a sample inside the one step of the impact sees the jump.",
        "The box is problem box-slide: m (v+ - v) = h u + f, |f| <= b = friction h m g by maximal"
        " dissipation, in two pairs; the paper gives no equations.",
        "The noise levels and every mu are our choice.",
    ),
)
