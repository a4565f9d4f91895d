"""What P3's data say of ex. III.5 and fig. 3."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, largest

_PLACE = "Pathologies, "
_RARE, _OFTEN = 0.3, 20.0
"""Expected samples within nu, of a run, below which most see none and above which all see some."""
_SMALL = 0.1
"""nu/sigma up to which nu is small: a relaxation much narrower than the noise."""


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.5 and fig. 3 say."""
    return [*_variance(data), *_few_samples(data), *_empirical_bias(data), _block(data)]


def _variance(data: xr.Dataset) -> list[Claim]:
    """Expected variances over nu, for nu small against sigma."""
    sigma, many = data.attrs["sigma"], data.attrs["many"]
    c = 1 / (np.sqrt(2 * np.pi) * sigma)
    small = data["nu"].values <= _SMALL * sigma
    nu, form = data["nu"].values[small], data["fobg_variance"].values[small]
    slope = float(np.polyfit(np.log(nu), np.log(form), 1)[0]) if small.sum() > 1 else np.nan
    ratio = form * nu / (4 * c)
    wide = data["wide_variance"]
    coarse = data["coarse"].values
    known, p = (np.interp(coarse, data["nu"], data[name]) for name in ("fobg_variance", "chance"))
    told = (coarse <= _SMALL * sigma) & (many * p >= 30)
    score = (wide.sel(order="fobg").values / known - 1)[told] * np.sqrt(many * p[told])
    flat = wide.sel(order="zobg").values[coarse <= _SMALL * sigma]
    factor = largest(flat) / flat.min(initial=np.inf)
    where = f" for nu <= {_SMALL:g} sigma"
    return [
        Claim("As nu falls the variance of the first order scales with 1/nu", _PLACE + "ex. III.5",
              "4 c/nu, c = 1/(sqrt(2 pi) sigma)", f"nu to the power {slope:.3f}, {ratio.min():.3f}"
              f" to {ratio.max():.3f} of it{where}; samples within"
              f" {largest(np.abs(score)):.2g} standard errors",
              bool(abs(slope + 1) < 0.02 and np.all(np.abs(ratio - 1) < 0.05)
                   and largest(np.abs(score)) < 5)),
        Claim("The variance of the zeroth order does not depend on nu", "our check",
              "flat", f"within a factor {factor:.3g}{where}",
              bool(factor < 1.05 + 10 * np.sqrt(2 / many))),
    ]  # fmt: skip


def _few_samples(data: xr.Dataset) -> list[Claim]:
    """What a run with few samples sees: nothing, and so no variance."""
    n, nu = data.attrs["n_samples"], data["nu"].values
    p = float(data["truth"]) * data.attrs["nu"] / 2
    sizes, silent = data["batch"].values, data["silent"].values
    few = sizes * p <= 0.1
    least = silent[few].min(initial=1) if few.any() else np.nan
    reach = f"up to {sizes[few].max()}" if few.any() else "none"
    hits = n * data["chance"].values
    empty = data["variance"].sel(order="fobg").values == 0
    # Where all samples fall within nu they vary no more either; that is not what is meant.
    rare, often = hits < _RARE, (hits > _OFTEN) & (data["chance"].values < 0.5)
    share = float(np.mean(empty[rare])) if rare.any() else np.nan
    return [
        Claim("First-order values are zero where few samples are taken", _PLACE + "fig. 3",
              f"0 for n well below 1/p = {1 / max(p, 1e-300):.3g} samples",
              f"all zero in {least:.0%} of runs or more for n {reach}, in {silent[-1]:.0%} of those"
              f" of {sizes[-1]}", bool(least > 0.5)),
        Claim("At a fixed sample count the empirical variance falls to zero as nu does",
              _PLACE + "fig. 3", "empty on a log scale",
              f"{empty.sum()} of {nu.size} tolerances show none: {share:.0%} of those with n p <"
              f" {_RARE:g}, {np.sum(empty & often)} of those with n p > {_OFTEN:g}",
              bool(share > 0.5 and not np.any(empty & often))),
    ]  # fmt: skip


def _empirical_bias(data: xr.Dataset) -> list[Claim]:
    """At theta = nu/2: gradient, both readings of the probability, and the triple."""
    sigma, many, ratio = data.attrs["sigma"], data.attrs["many"], data["ratio"].values
    c = 1 / (np.sqrt(2 * np.pi) * sigma)
    F, p = data["half_gradient"].values, data["half_chance"].values
    beta, small = c * sigma * ratio, ratio <= 1
    off = np.abs(data["half_share"].values - p) / np.sqrt(p * (1 - p) / many + 1 / many**2)
    sampled = bool(off.max() < 5)
    rare = p <= beta * (1 + 1e-9)
    biased = c <= F
    still = data["half_spread"].values == 0
    triple = rare & biased & still
    where = f" for nu <= {ratio[small].max():.3g} sigma"
    beyond = f", not from {ratio[~triple].min():.3g} on" if not triple.all() else ""
    return [
        Claim("At theta = nu/2 the gradient is c = 1/(sqrt(2 pi) sigma)", _PLACE + "ex. III.5",
              f"{c:.4g} s/m", f"{(F[small] / c).min():.3g} to {(F[small] / c).max():.4g} times c"
              + where, bool(np.allclose(F[small], c, rtol=0.01))),
        Claim("There the sample gradient is zero with probability at least c nu",
              _PLACE + "ex. III.5", "as printed: P(zero) >= c nu",
              f"P(zero) from {1 - p[small].max():.3g} to {1 - p[small].min():.5f}, c nu up to"
              f" {beta[small].max():.3g}{where}",
              bool(np.all(1 - p[small] >= beta[small]) and sampled)),
        Claim("It is zero with probability at least 1 - c nu", "the event that ex. III.5 means",
              "P(not zero) <= c nu", f"P(not zero) is {(p / beta)[small].min():.3f} to"
              f" {(p / beta)[small].max():.4f} of c nu{where}; samples within {off.max():.2g}"
              " standard errors", bool(np.all(rare[small]) and sampled)),
        Claim("The FoBG has (c nu, c, 0)-empirical bias", _PLACE + "ex. III.5, def. III.3",
              "on P(E) >= 1 - c nu: off by c or more, no spread",
              f"off by {(F[small] / c).min():.3g} c or more, spread"
              f" {data['half_spread'].values[small].max():g} s/m{where}; holds up to"
              f" {ratio[triple].max(initial=0):.3g} sigma{beyond}",
              bool(np.all(triple[small]))),
    ]  # fmt: skip


def _block(data: xr.Dataset) -> Claim:
    """The block on the belt, whose mass bounds the slope."""
    width, block = float(data["stick"]), data["block_variance"].sel(order="fobg").values
    narrow = data["block_nu"].values <= width / 10 * (1 + 1e-9)
    stays = largest(block[narrow]) / block[narrow].min(initial=np.inf)
    return Claim(
        "With a body behind the friction the variance grows no further than its mass lets it",
        "our check", f"constant for nu well below 2 N h F/m = {width:g} m/s",
        f"within a factor {stays:.2f} for nu <= {width / 10:g} m/s", bool(stays < 1.5),
    )  # fmt: skip
