"""AT: gradient ascent on the throw of a ball, and a theorem's bound on the smallest gradient along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from dynamics.contact import Adaptive, Barrier, ContactLaw
from ocp.learning.experiment import Experiment
from ocp.learning.unroll_gradients import FOPG, SHARP_LAW
from problems.studies.study import Claim, StudyParams, claim, dataset, setting, settings_text
from problems.tasks.registry import get

NOTES = (
    "J is the mean exact return of the throw under the policy's noise; its gradient, and its"
    " Lipschitz constant L on the window the iterates stay in, come from a fine grid of returns"
    " folded with the noise's density, independent of any estimator.",
    "c = 1/(eta - L eta²) needs eta < 1/L; the theorem's index slips (errata, 27) are mended:"
    " the sum of gains telescopes over all steps taken.",
    "delta is the largest |theta| among the iterates.",
)
QUICK = {"runs": 2, "iterations": 20, "measured": 2000}

LAWS: dict[str, ContactLaw] = {
    "exact": SHARP_LAW,
    **{f"barrier {mu:g}": Barrier(mu=mu) for mu in (1e-4, 1e-3, 1e-2)},
    "adaptive": Adaptive("quartic"),
}
"""Mapping from names to the contact laws of the gradient; mu in N s m."""
_TAIL_DEVIATIONS = 5.0
"""Distance by which the grid of returns extends beyond the window, in standard deviations of the noise."""


class Params(StudyParams):
    """Parameters of study AT; all defaults are our choice."""

    runs: int = setting(5, "1", "runs, each from a throw of its own", least=2)
    iterations: int = setting(60, "1", "steps of ascent N", least=2)
    samples: int = setting(16, "1", "throws in a gradient M", least=2)
    measured: int = setting(20000, "1", "throws that measure bias and variance", least=100)
    sigma: float = setting(0.1, "1", "noise on the decision before it is bounded", above=0)
    step: float = setting(0.25, "1", "step eta over the largest, 1/(2 L)", above=0, most=1)
    grid: int = setting(301, "1", "points of the grid of returns along each axis", least=51)
    reach: float = setting(0.35, "1", "half the window of theta around its middle", above=0.3)


@dataclass(frozen=True)
class Landscape:
    """Expected return J (n, n) under Gaussian noise and its gradient (n, n, 2), on a grid of theta."""

    axes: tuple[np.ndarray, np.ndarray]
    value: np.ndarray
    slope: np.ndarray

    def at(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return J (n,) and its gradient (n, 2) at ``theta`` (n, 2), interpolated linearly; NaN outside the grid."""
        from scipy.interpolate import RegularGridInterpolator

        options = {"bounds_error": False, "fill_value": np.nan}
        value = RegularGridInterpolator(self.axes, self.value, **options)(theta)
        return value, RegularGridInterpolator(self.axes, self.slope, **options)(theta)

    @property
    def lipschitz(self) -> float:
        """Largest spectral norm of J's Hessian on the grid, by differences of the gradient."""
        second = [np.gradient(self.slope[..., i], *self.axes) for i in (0, 1)]
        hessian = np.moveaxis(np.array(second), (0, 1), (-2, -1))
        return float(np.linalg.norm(hessian, ord=2, axis=(-2, -1)).max())


def run(params: Params) -> xr.Dataset:
    """Compute iterates, values of J, and the gradient's norm, bias and variance at every step of every run."""
    task = get("ball-throw")
    judge = Experiment(task=task, algorithm=FOPG(), law=SHARP_LAW, hidden=None)
    middle = np.array([0.2, -0.45])
    landscape = _landscape(judge, middle, params)
    lipschitz = landscape.lipschitz
    eta = params.step / (2 * lipschitz)
    shape = (len(LAWS), params.runs, params.iterations)
    theta = np.zeros((*shape[:2], params.iterations + 1, 2))
    bias, variance, slope = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    value = np.zeros((*shape[:2], params.iterations + 1))
    for i, law in enumerate(LAWS.values()):
        for r in range(params.runs):
            rng = np.random.default_rng([params.seed, r])
            theta[i, r, 0] = middle + np.array([-0.2, 0.0]) + 0.1 * rng.uniform(-1, 1, 2)
            for k in range(params.iterations):
                decision = theta[i, r, k]
                value[i, r, k], true = (a[0] for a in landscape.at(decision[None]))
                mean, spread = _moments(judge, law, decision, params.measured, params, (r, k, 1))
                bias[i, r, k] = np.linalg.norm(true - mean)
                variance[i, r, k] = spread / params.samples
                slope[i, r, k] = np.linalg.norm(true)
                step, _ = _moments(judge, law, decision, params.samples, params, (r, k, 0))
                theta[i, r, k + 1] = decision + eta * step
            value[i, r, -1] = landscape.at(theta[i, r, -1][None])[0][0]
    every = ("law", "run", "iteration")
    return dataset(
        {
            "theta": (("law", "run", "node", "axis"), theta, "1", "iterate"),
            "value": (("law", "run", "node"), value, "m^2", "J"),
            "slope": (every, slope, "m^2", "norm of the gradient of J"),
            "bias": (every, bias, "m^2", "norm of the gradient's bias"),
            "variance": (every, variance, "m^4", "variance of the batch's gradient"),
            "lipschitz": ((), lipschitz, "m^2", "Lipschitz constant of the gradient"),
            "eta": ((), eta, "1/m^2", "step"),
        },
        {"law": list(LAWS)},
    )


def bound_sides(data: xr.Dataset, law: str) -> tuple[float, float]:
    """Return both sides of Zhang et al. 2023, thm. 4.2, for one law; means over runs replace the expectations.

    ``min_n E|grad J|² <= 4c/N E[J_N - J_0] + 4/N sum_n (c (2 delta b_n + eta/2 v_n) + b_n² + v_n)``
    with ``c = 1/(eta - L eta²)``, bias b_n, variance v_n, step eta, and delta the largest |theta|.
    """
    runs = data.sel(law=law)
    eta, lipschitz = float(data["eta"]), float(data["lipschitz"])
    c = 1 / (eta - lipschitz * eta**2)
    n = runs.sizes["iteration"]
    b, v = runs["bias"].values, runs["variance"].values
    delta = float(np.linalg.norm(runs["theta"].values, axis=-1).max())
    gained = runs["value"].values[:, -1] - runs["value"].values[:, 0]
    terms = c * (2 * delta * b + eta / 2 * v) + b**2 + v
    right_side = 4 * c / n * gained.mean() + 4 / n * terms.sum(axis=1).mean()
    mean_square = float((runs["slope"].values ** 2).mean(axis=0).min())
    return mean_square, float(right_side)


def _landscape(judge: Experiment, middle: np.ndarray, params: Params) -> Landscape:
    """Convolve exact returns V on a grid with the noise's density p: ``J = V * p``, ``grad J = V * grad p``."""
    from scipy.signal import fftconvolve

    wide = params.reach + _TAIL_DEVIATIONS * params.sigma
    ticks = np.linspace(-wide, wide, params.grid)
    axes = tuple(middle[i] + ticks for i in (0, 1))
    theta = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    x0 = judge.task.reset(1, np.random.default_rng(0))
    returns = judge.rollouts(judge.task.horizon, SHARP_LAW)(x0, theta).value
    table, step = returns.reshape(params.grid, -1), ticks[1] - ticks[0]
    reach = round(_TAIL_DEVIATIONS * params.sigma / step)
    offsets = step * np.arange(-reach, reach + 1)
    density = np.exp(-(offsets**2) / (2 * params.sigma**2))
    density /= density.sum()
    # The gradient's kernel is minus the density's gradient, since a convolution mirrors it.
    leaning = -offsets / params.sigma**2 * density
    kernels = np.outer(density, density), np.outer(leaning, density), np.outer(density, leaning)
    value, first, second = (fftconvolve(table, kernel, mode="valid") for kernel in kernels)
    inner = tuple(axis[reach : len(axis) - reach] for axis in axes)
    return Landscape((inner[0], inner[1]), value, np.stack([first, second], axis=-1))


def _moments(
    judge: Experiment, law: ContactLaw, theta: np.ndarray, n: int, params: Params, key: tuple[int, ...]
) -> tuple[np.ndarray, float]:
    """Return the mean gradient (2,) of n throws and the trace of the covariance of one throw's gradient."""
    seed = np.random.SeedSequence(params.seed, spawn_key=key)
    x0 = judge.task.reset(1, np.random.default_rng(0))
    moments = judge.rollouts(judge.task.horizon, law).moments(
        x0, theta, noise=Gaussian(params.sigma, seed), n_samples=n
    )
    assert moments.gradient is not None
    return moments.gradient.mean, float(moments.gradient.m2.sum() / (moments.gradient.n - 1))


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the bound, its tightness, and bias and variance."""
    laws = [str(law) for law in data["law"].values]
    sides = [bound_sides(data, law) for law in laws]
    is_bounded = [mean_square <= right_side for mean_square, right_side in sides]
    ratios = [right_side / mean_square for mean_square, right_side in sides]
    inside = np.isfinite(data["value"].values).all()
    bias = [float(data["bias"].sel(law=law).mean()) for law in laws]
    variance = [float(data["variance"].sel(law=law).mean()) for law in laws]
    smooth = [k for k, law in enumerate(laws) if law != "exact"]
    lower = [variance[k] < variance[0] for k in smooth]
    higher = [bias[k] > bias[0] for k in smooth]
    gains = (data["value"][..., -1] - data["value"][..., 0]).mean("run").values
    most_gained = laws[int(np.argmax(gains))]
    unit = data["bias"].attrs["units"]
    least_biased = laws[int(np.argmin(bias))]
    return [
        claim("The smallest mean square gradient is below the bound", "ABS, thm. 4.2")
        .expected("left side at most the right one, under every law")
        .measured(f"{settings_text(laws, is_bounded)}: {', '.join(f'{a:.2g} <= {b:.2g}' for a, b in sides)}")
        .holds(is_bounded, inside),
        claim("The bound is close to what it bounds", "our check")
        .expected("at most 10 times as large")
        .measured(", ".join(f"{ratio:.3g}" for ratio in ratios))
        .at_most(ratios, 10),
        claim("Smoothing lowers the gradient's variance", "ABS, sec. 4.3")
        .expected("below the exact law's, mean over steps and runs")
        .measured(
            f"{settings_text([laws[k] for k in smooth], lower)}: exact {variance[0]:.3g}, then"
            f" {', '.join(f'{variance[k]:.3g}' for k in smooth)}"
            f" {data['variance'].attrs['units']}"
        )
        .holds(lower),
        claim("Smoothing adds bias", "ABS, sec. 5.1")
        .expected("above the exact law's")
        .measured(
            f"{settings_text([laws[k] for k in smooth], higher)}: exact {bias[0]:.3g}, then"
            f" {', '.join(f'{bias[k]:.3g}' for k in smooth)} {unit}"
        )
        .holds(higher),
        claim("The law of the least bias climbs the most", "our check")
        .expected(f"{least_biased}, of the least mean bias")
        .measured(f"{most_gained} gained {gains.max():.3g} {unit}")
        .equals(most_gained, least_biased),
    ]
