"""A2v: variance of first-order and likelihood-ratio gradients of a landing ball, over mu."""

from __future__ import annotations

import casadi as ca
import numpy as np
import xarray as xr
from pydantic import model_validator

from dynamics.batch import Gaussian, RolloutFunction, open_loop
from dynamics.contact import Barrier
from problems.registry import get
from problems.studies.study import Claim, StudyParams, claim, dataset, setting, settings_text

NOTES = (
    "Time stepping is plastic, so no chaos builds up over bounces: after the impact the ball"
    " forgets its height. Variance is largest where the rollout ends near the impact.",
    "mu is that of the impulse, in N s m; positions and velocities weigh one in SI units.",
)

MUS = 10.0 ** np.arange(-6, 1)
"""Central-path parameters [N s m]."""
STEPS = (0.02, 0.01, 0.005, 0.0025)
"""Step sizes of time stepping [s]."""


class Params(StudyParams):
    """Parameters of study A2v; all defaults are our choice, since the paper gives none."""

    g: float = setting(9.81, "m/s^2", "gravity", above=0)
    q0: float = setting(1.0, "m", "height of the throw", above=0)
    v0: float = setting(1.0, "m/s", "horizontal velocity")
    sigma: float = setting(0.1, "m/s", "noise on each component of the throw", above=0)
    n_samples: int = setting(1000, "1", "samples", least=10)
    first: float = setting(0.36, "s", "earliest end of the rollout", least=max(STEPS))
    last: float = setting(1.0, "s", "latest end of the rollout", least=max(STEPS))

    @model_validator(mode="after")
    def _in_order(self) -> Params:
        if self.first > self.last:
            raise ValueError(
                f"the earliest end of the rollout, first = {self.first:g} s, must not come after"
                f" the latest, last = {self.last:g} s"
            )
        return self


def run(params: Params) -> xr.Dataset:
    """Compute the largest variance of each gradient over both parameters and over all lengths of the rollout.

    The parameters are the two velocities of the throw, given by a thrust in the first step; the
    return R is the squared distance of the final (q, v) from (v0, 0, v0, 0). The likelihood-ratio
    gradient is that of evolution strategies: ``(R(theta + w) - R(theta - w)) w / (2 sigma²)``.
    """
    shape = (len(STEPS), len(MUS))
    first, ratio = np.empty(shape), np.empty(shape)
    ends = np.arange(params.first, params.last + 1e-9, 0.02)
    for row, h in enumerate(STEPS):
        cells = [_variances(params, h, round(end / h)) for end in ends]
        first[row], ratio[row] = np.max(cells, axis=0)
    dimensions = ("h", "mu")
    unit = "s^2/m^2"
    return dataset(
        {
            "first_order": (dimensions, first, unit, "largest variance, first order"),
            "likelihood_ratio": (dimensions, ratio, unit, "largest variance, LR"),
        },
        {"h": (STEPS, "s", "step size"), "mu": (MUS, "N s m", "central-path parameter")},
    )


def _variances(params: Params, h: float, steps: int) -> np.ndarray:
    """Return first-order and likelihood-ratio variances, each the larger of two parameters', (2, len(MUS))."""
    problem = get("ball-bounce", h=h, g=params.g)
    step = Barrier(mu=1.0).close(problem.system)
    x, u, p = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("p", len(step.p))
    goal = ca.DM([params.v0, 0, params.v0, 0])
    rollout = RolloutFunction(
        step,
        ca.Function("no_stage_cost", [x, u, p], [ca.SX(0)]),
        ca.Function("distance", [x, p], [ca.sumsqr(x - goal)]),
        steps,
        open_loop(4, 2),
    )
    # A thrust of m v/h in the first step throws the ball with velocity v; m = 1 kg.
    theta = np.zeros((steps, 2))
    theta[0] = params.v0 / h, params.g
    noise = np.zeros((params.n_samples, steps, 2))
    w = Gaussian(params.sigma, params.seed).draw(params.n_samples, 1, 2)[:, 0]
    noise[:, 0] = w / h
    start = np.array([0.0, params.q0, 0.0, 0.0])
    variances = []
    for mu in MUS:
        values = step.p.pack(mu=mu)
        up = rollout(start, theta, values, noise)
        down = rollout(start, theta, values, -noise, gradient=False)
        assert up.gradient is not None
        gradient = up.gradient[:, 0] / h
        ratio = (up.cost - down.cost)[:, None] * w / (2 * params.sigma**2)
        variances.append((gradient.var(axis=0, ddof=1).max(), ratio.var(axis=0, ddof=1).max()))
    return np.transpose(variances)


_STIFF_MU = 1e-3
"""Value of mu [N s m] up to which the landing counts as stiff."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Zhang et al. 2023, sec. 4.3 and 7.2."""
    mu, h = data["mu"].values, data["h"].values
    first, ratio = data["first_order"].values, data["likelihood_ratio"].values
    soft = int(np.abs(np.log(mu / 1e-1)).argmin())
    large = first[:, 0] > 10 * first[:, soft]
    stiff = mu <= _STIFF_MU * (1 + 1e-9)
    flat = first[:, 0] / first[:, 1]
    share = ratio[:, stiff] / first[:, stiff]
    low = np.all(share < 0.1, axis=1)
    spread = ratio[:, stiff].max(axis=1) / ratio[:, stiff].min(axis=1)
    slope = float(np.polyfit(np.log(h), np.log(first[:, 0]), 1)[0])
    steps = list(h)
    return [
        claim("Stiff systems with small mu lead to large first-order variance", "ABS, sec. 7.2")
        .expected(f"at mu = {mu[0]:g} ten times that at {mu[soft]:g}")
        .measured(f"h {settings_text(steps, large)} s: {(first[:, 0] / first[:, soft]).min():.2g} times or more")
        .holds(large),
        claim("That variance grows without bound as mu falls", "ABS, sec. 4.3")
        .expected("with a tenth of mu twice the variance or more")
        .measured(f"{flat.min():.3f} to {flat.max():.3f} times from mu = {mu[1]:g} to {mu[0]:g}")
        .above(flat, 2),
        claim("What bounds it is the step: the slope through an impact is 1/h", "our check")
        .expected("variance ~ 1/h at small mu")
        .measured(f"h to the power {slope:.2f}")
        .between(slope, -1.4, -0.6),
        claim("LR gradients have low variance in the presence of stiffness", "ABS, sec. 7.2")
        .expected(f"a tenth of first order or less for mu <= {_STIFF_MU:g}")
        .measured(f"h {settings_text(steps, low)} s: {share.min():.2f} to {share.max():.2f} of first order")
        .holds(low),
        claim("The variance of LR does not change as mu falls", "our check")
        .expected(f"flat for mu <= {_STIFF_MU:g}")
        .measured(
            f"within a factor {spread.max():.3g}, as first order"
            f" within {(first[:, stiff].max(axis=1) / first[:, stiff].min(axis=1)).max():.3g}"
        )
        .below(spread, 3),
    ]
