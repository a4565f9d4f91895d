"""P3: Coulomb friction relaxed within a slip tolerance, and the empirical bias of its gradient."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from ocp.gradients import SampledObjective, estimate_gradient
from ocp.gradients.estimators import SAMPLED
from problems.registry import objective_spec
from problems.studies.study import CODE, Claim, StudyParams, claim, dataset, largest_value, setting

NOTES = (
    "The relaxation is one of the sign, 2 H - 1, not of H.",
    "Ex. III.5 has its gradient zero with probability at least c nu: true for small nu, where"
    " it is zero nearly always, and too little for the triple, which needs 1 - c nu.",
    "The closed form of F in the text is that of neither; the one used here is checked by quadrature.",
    "Behind it a block of 100 kg dragged from rest by a belt with at most 5 N for 0.1 s.",
)

ORDERS = ("zobg", "fobg")
"""Names of the estimators that are compared."""
_PANEL_NUS = (1e-3, 0.2)
"""Slip tolerances [m/s] of the curves in the panel over the sliding velocity."""
BATCHES = (1, 3, 10, 30, 100, 300, 1000)
"""Batch sizes for which the fraction of zero batches is measured."""
_RATIOS = np.geomspace(1e-4, 10, 21)
"""Ratios nu/sigma at which theta = nu/2 is evaluated; the text of the paper concerns small ratios."""


class Params(StudyParams):
    """Parameters of study P3, with the values of the authors' code but fewer slip tolerances."""

    sigma: float = setting(0.1, "m/s", "standard deviation of the noise", CODE, above=0)
    theta: float = setting(0.1, "m/s", "decision of the panel over samples", CODE)
    nu: float = setting(0.005, "m/s", "slip tolerance of the panel over samples", CODE, above=0)
    n_samples: int = setting(1000, "1", "samples", CODE, least=2)
    tolerances: int = setting(81, "1", "slip tolerances from 1e-4 to 1 sigma", least=20)
    many: int = setting(400_000, "1", "samples of the expected variance", least=1000)


def run(params: Params) -> xr.Dataset:
    """Compute running means of both gradient estimators, and their variances for every slip tolerance.

    The variances are computed for Coulomb friction alone and for a block on a belt.
    """
    nus = params.sigma * np.geomspace(1e-4, 1, params.tolerances)
    coarse = nus[:: max(1, params.tolerances // 8)]
    widths = _stick_width() * np.geomspace(1e-3, 10, 9)
    coulomb = objective_spec("coulomb").objective({"theta": 0.0})
    block = objective_spec("belt-block").objective()
    at_theta = objective_spec("coulomb").objective({"theta": params.theta, "nu": params.nu})
    running = np.stack([_running_mean(at_theta, name, params) for name in ORDERS])
    objectives = [coulomb.at({"nu": nu}) for nu in nus]
    few = [_variances(o, i, params.n_samples, params) for i, o in enumerate(objectives)]
    forms = [objective.closed_form(params.sigma) for objective in objectives]
    wide, of_block = (
        np.transpose([_variances(o.at({"nu": nu}), 1000 + i, params.many, params) for i, nu in enumerate(grid)])
        for o, grid in ((coulomb, coarse), (block, widths))
    )
    slip = np.linspace(-1, 1, 401)
    friction, impulse = ([o.at({"nu": nu}).costs(slip[:, None]) for nu in _PANEL_NUS] for o in (coulomb, block))
    chance = [c.gradient[0] * nu / 2 for c, nu in zip(forms, nus, strict=True) if c]
    at_half, silent = _at_half(coulomb, params), _silent(at_theta, params)
    closed_form = at_theta.closed_form(params.sigma)
    assert closed_form is not None
    unit = "s/m"
    return dataset(
        {
            "friction": (("width", "slip"), friction, "1", "friction over its limit"),
            "block_impulse": (("width", "slip"), impulse, "1", "impulse on the block over its limit"),
            "running_mean": (("order", "n"), running, unit, "estimate of n samples"),
            "truth": ((), closed_form.gradient[0], unit, "gradient at theta"),
            "silent": ("batch", silent, "1", "share of batches whose first-order samples are all zero"),
            "chance": ("nu", chance, "1", "of a first-order sample not zero"),
            "half_gradient": ("ratio", at_half[:, 0], unit, "gradient at theta = nu/2"),
            "half_chance": ("ratio", at_half[:, 1], "1", "of a sample not zero there"),
            "half_share": ("ratio", at_half[:, 2], "1", "of samples not zero there"),
            "half_spread": ("ratio", at_half[:, 3], unit, "largest sample there with theta + w outside the tolerance"),
            "stick": ((), _stick_width(), "m/s", "2 N h F/m, below which the block's mass limits the slope"),
            "variance": (("order", "nu"), np.transpose(few), "s^2/m^2", "empirical variance of one sample"),
            "zobg_variance": ("nu", [c.zobg_variance[0] for c in forms if c], "s^2/m^2", "of one sample, closed form"),
            "fobg_variance": ("nu", [c.fobg_variance[0] for c in forms if c], "s^2/m^2", "of one sample, closed form"),
            "wide_variance": (("order", "coarse"), wide, "s^2/m^2", "empirical variance of one sample, many samples"),
            "block_variance": (("order", "block_nu"), of_block, "s^2/m^2", "the same of the block on a belt"),
        },
        {
            "order": list(ORDERS),
            "width": (_PANEL_NUS, "m/s", "slip tolerance"),
            "slip": (slip, "m/s", "sliding velocity"),
            "n": (np.arange(1, params.n_samples + 1), "1", "samples"),
            "nu": (nus, "m/s", "slip tolerance"),
            "coarse": (coarse, "m/s", "slip tolerance"),
            "block_nu": (widths, "m/s", "slip tolerance under the block"),
            "batch": (BATCHES, "1", "samples of one batch"),
            "ratio": (_RATIOS, "1", "nu/sigma"),
        },
    )


def _at_half(coulomb: SampledObjective, params: Params) -> np.ndarray:
    """Return rows of four numbers at theta = nu/2, one row for each of :data:`_RATIOS`.

    The numbers are F', the probability of a nonzero first-order sample, the observed fraction of nonzero samples,
    and the largest absolute sample whose noise puts the sliding velocity outside the slip tolerance.
    """
    rows = []
    for index, nu in enumerate(params.sigma * _RATIOS):
        objective = coulomb.at({"theta": nu / 2, "nu": nu})
        closed_form = objective.closed_form(params.sigma)
        assert closed_form is not None
        seed = np.random.SeedSequence(params.seed, spawn_key=(2000 + index,))
        noise = Gaussian(params.sigma, seed)
        samples = objective.sample_gradients(noise, params.many).direction[:, 0]
        outside = np.abs(nu / 2 + noise.draw(params.many, 1, 1)[:, 0, 0]) > nu / 2
        gradient = closed_form.gradient[0]
        rows.append((gradient, gradient * nu / 2, np.mean(samples != 0), np.abs(samples[outside]).max(initial=0)))
    return np.array(rows)


def _silent(objective: SampledObjective, params: Params) -> np.ndarray:
    """Return the fraction of batches whose first-order samples are all zero, for each size in :data:`BATCHES`."""
    seed = np.random.SeedSequence(params.seed, spawn_key=(3000,))
    samples = objective.sample_gradients(Gaussian(params.sigma, seed), params.many).direction[:, 0]
    return np.array(
        [np.mean(~np.any(samples[: len(samples) // size * size].reshape(-1, size), axis=1)) for size in BATCHES]
    )


def _stick_width() -> float:
    block = objective_spec("belt-block").params({})
    return 2 * block.N * block.h * block.friction_force / block.m


def _running_mean(objective: SampledObjective, name: str, params: Params) -> np.ndarray:
    estimator = SAMPLED[name]
    noise = Gaussian(params.sigma, np.random.SeedSequence(params.seed, spawn_key=(estimator.stream,)))
    samples = estimator.make_sampler(objective, noise, params.n_samples).single(noise, params.n_samples)
    return np.cumsum(samples[:, 0]) / np.arange(1, params.n_samples + 1)


def _variances(objective: SampledObjective, key: int, n: int, params: Params) -> list[float]:
    seed = np.random.SeedSequence(params.seed, spawn_key=(key,))
    estimates = estimate_gradient(objective, ORDERS, n, params.sigma, seed, reference="none")
    return [float(estimates[name].variance[0]) for name in ORDERS]


_RARE_SAMPLES = 0.3
"""Expected number of samples of a run within nu below which most runs have no such sample."""
_FREQUENT_SAMPLES = 20.0
"""Expected number of samples of a run within nu above which every run has such samples."""
_SMALL_NU = 0.1
"""Largest nu/sigma that counts as small: a relaxation much narrower than the noise."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Suh et al. 2022, ex. III.5 and fig. 3."""
    return [*_variance(data), *_few_samples(data), *_empirical_bias(data), _block(data)]


def _variance(data: xr.Dataset) -> list[Claim]:
    """Check both variances over the slip tolerance nu, where nu is small compared with sigma."""
    sigma, many = data.attrs["sigma"], data.attrs["many"]
    c = 1 / (np.sqrt(2 * np.pi) * sigma)
    small = data["nu"].values <= _SMALL_NU * sigma
    nu, form = data["nu"].values[small], data["fobg_variance"].values[small]
    slope = float(np.polyfit(np.log(nu), np.log(form), 1)[0]) if small.sum() > 1 else np.nan
    ratio = form * nu / (4 * c)
    wide = data["wide_variance"]
    coarse = data["coarse"].values
    variances, p = (np.interp(coarse, data["nu"], data[name]) for name in ("fobg_variance", "chance"))
    is_sampled = (coarse <= _SMALL_NU * sigma) & (many * p >= 30)
    score = (wide.sel(order="fobg").values / variances - 1)[is_sampled] * np.sqrt(many * p[is_sampled])
    flat = wide.sel(order="zobg").values[coarse <= _SMALL_NU * sigma]
    factor = largest_value(flat) / flat.min(initial=np.inf)
    range_text = f" for nu <= {_SMALL_NU:g} sigma"
    return [
        claim("As nu falls the variance of the first order scales with 1/nu", "Pathologies, ex. III.5")
        .expected("4 c/nu, c = 1/(sqrt(2 pi) sigma)")
        .measured(
            f"nu to the power {slope:.3f}, {ratio.min():.3f}"
            f" to {ratio.max():.3f} of it{range_text}; samples within"
            f" {largest_value(np.abs(score)):.2g} standard errors"
        )
        .holds(abs(slope + 1) < 0.02, np.abs(ratio - 1) < 0.05, largest_value(np.abs(score)) < 5),
        claim("The variance of the zeroth order does not depend on nu", "our check")
        .expected("flat")
        .measured(f"within a factor {factor:.3g}{range_text}")
        .below(factor, 1.05 + 10 * np.sqrt(2 / many)),
    ]


def _few_samples(data: xr.Dataset) -> list[Claim]:
    """Check that with few samples the first-order gradient and its variance are usually zero."""
    n, nu = data.attrs["n_samples"], data["nu"].values
    p = float(data["truth"]) * data.attrs["nu"] / 2
    sizes, silent = data["batch"].values, data["silent"].values
    few = sizes * p <= 0.1
    least_share = silent[few].min(initial=1) if few.any() else np.nan
    reach = f"up to {sizes[few].max()}" if few.any() else "none"
    hits = n * data["chance"].values
    empty = data["variance"].sel(order="fobg").values == 0
    # If all samples fall within nu, their variance is zero too; the claim does not concern that case.
    rare, often = hits < _RARE_SAMPLES, (hits > _FREQUENT_SAMPLES) & (data["chance"].values < 0.5)
    share = float(np.mean(empty[rare])) if rare.any() else np.nan
    return [
        claim("First-order values are zero where few samples are taken", "Pathologies, fig. 3")
        .expected(f"0 for n well below 1/p = {1 / max(p, 1e-300):.3g} samples")
        .measured(
            f"all zero in {least_share:.0%} of runs or more for n {reach}, in {silent[-1]:.0%} of those of {sizes[-1]}"
        )
        .above(least_share, 0.5),
        claim("At a fixed sample count the empirical variance falls to zero as nu does", "Pathologies, fig. 3")
        .expected("empty on a log scale")
        .measured(
            f"{empty.sum()} of {nu.size} tolerances show none: {share:.0%} of those with n p <"
            f" {_RARE_SAMPLES:g}, {np.sum(empty & often)} of those with n p > {_FREQUENT_SAMPLES:g}"
        )
        .holds(share > 0.5, not np.any(empty & often)),
    ]


def _empirical_bias(data: xr.Dataset) -> list[Claim]:
    """Check gradient, empirical bias and two statements on the probability of zero samples, all at theta = nu/2."""
    sigma, many, ratio = data.attrs["sigma"], data.attrs["many"], data["ratio"].values
    c = 1 / (np.sqrt(2 * np.pi) * sigma)
    F, p = data["half_gradient"].values, data["half_chance"].values
    beta, small = c * sigma * ratio, ratio <= 1
    score = np.abs(data["half_share"].values - p) / np.sqrt(p * (1 - p) / many + 1 / many**2)
    sampled = bool(score.max() < 5)
    rare = p <= beta * (1 + 1e-9)
    biased = c <= F
    still = data["half_spread"].values == 0
    triple = rare & biased & still
    range_text = f" for nu <= {ratio[small].max():.3g} sigma"
    beyond = f", not from {ratio[~triple].min():.3g} on" if not triple.all() else ""
    return [
        claim("At theta = nu/2 the gradient is c = 1/(sqrt(2 pi) sigma)", "Pathologies, ex. III.5")
        .expected(f"{c:.4g} s/m")
        .measured(f"{(F[small] / c).min():.3g} to {(F[small] / c).max():.4g} times c" + range_text)
        .holds(np.allclose(F[small], c, rtol=0.01)),
        claim("There the sample gradient is zero with probability at least c nu", "Pathologies, ex. III.5")
        .expected("as printed: P(zero) >= c nu")
        .measured(
            f"P(zero) from {1 - p[small].max():.3g} to {1 - p[small].min():.5f}, c nu up to"
            f" {beta[small].max():.3g}{range_text}"
        )
        .holds(1 - p[small] >= beta[small], sampled),
        claim("It is zero with probability at least 1 - c nu", "the event that ex. III.5 means")
        .expected("P(not zero) <= c nu")
        .measured(
            f"P(not zero) is {(p / beta)[small].min():.3f} to"
            f" {(p / beta)[small].max():.4f} of c nu{range_text}; samples within {score.max():.2g}"
            " standard errors"
        )
        .holds(rare[small], sampled),
        claim("The FoBG has (c nu, c, 0)-empirical bias", "Pathologies, ex. III.5, def. III.3")
        .expected("on P(E) >= 1 - c nu: off by c or more, no spread")
        .measured(
            f"off by {(F[small] / c).min():.3g} c or more, spread"
            f" {data['half_spread'].values[small].max():g} s/m{range_text}; holds up to"
            f" {ratio[triple].max(initial=0):.3g} sigma{beyond}"
        )
        .holds(triple[small]),
    ]


def _block(data: xr.Dataset) -> Claim:
    """Check that the mass of the block on the belt bounds the slope."""
    width, block = float(data["stick"]), data["block_variance"].sel(order="fobg").values
    narrow = data["block_nu"].values <= width / 10 * (1 + 1e-9)
    stays = largest_value(block[narrow]) / block[narrow].min(initial=np.inf)
    return (
        claim("With a body behind the friction its mass bounds the variance", "our check")
        .expected(f"constant for nu well below 2 N h F/m = {width:g} m/s")
        .measured(f"within a factor {stays:.2f} for nu <= {width / 10:g} m/s")
        .below(stays, 1.5)
    )
