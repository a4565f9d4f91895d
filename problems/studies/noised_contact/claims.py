"""Claims of N1 on Suh et al. 2023, fig. 1, sec. IV-B and sec. IV-C."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, claim, format_values, largest_value, settings_text

_MATCH_SHARE = 1 / 2
"""Ratio of the distance of two maps to its reference (a noise effect, or sigma) below which they match."""
_SETS_SHARE = 0.8
"""Minimum fraction of the data sets for which a claim must hold."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the pusher and on the block between walls, each learned from dense and sparse data."""
    return [*_dense(data), *_sparse(data), *_penetrating(data), *_support(data), *_rollouts(data)]


def _rms(errors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(errors**2, axis=-1))


def _dense(data: xr.Dataset) -> list[Claim]:
    """Compare samples of f_sigma, g_sigma and networks with f_sigma, in the middle and at the upper end of the data."""
    sigma, u, widths = data.attrs["sigma"], data["u"].values, list(data["width"].values)
    score = ((data["sampled"] - data["true_dots"]) / data["sampled_error"]).values
    # Far below the kink all samples are zero, so that their standard error is zero too.
    score = score[np.abs(data["sampled_error"].values) > 1e-6]
    square = data["score_square"].mean("set").values
    rms, error = data["dense_rms"].values, data["dense_error"].values
    dense_data = data.sel(regime="dense")
    kink, ends = np.abs(u) <= sigma, (u >= 1 - sigma) & (u <= 1)
    difference = _rms((dense_data["pusher_h"].values - data["f_sigma"].values)[:, kink])
    effect = _rms((data["f"] - data["f_sigma"]).values[kink])
    off_g = _rms((dense_data["pusher_h"] - dense_data["pusher_g"]).values[:, ends])
    off_f = _rms((dense_data["pusher_h"] - data["f_sigma"]).values[:, ends])
    end = data["end_score"].values
    return [
        claim("Monte Carlo estimates f_sigma", "Noising data, fig. 1 and eq. 2")
        .expected("within 5 standard errors of the closed form")
        .measured(f"{largest_value(np.abs(score)):.2g} at most, at {score.size} dots")
        .below(np.abs(score), 5),
        claim("Dense: g_sigma is f_sigma away from the ends", "Noising data, sec. IV-B")
        .expected("apart by the standard error of g_sigma: the mean square over it is 0.5 to 1.5, 3 sigma off the ends")
        .measured(
            f"{format_values(square, '.2f')} over {data.sizes['set']} sets at sigma = "
            + format_values(widths, "g")
            + f" m; apart by {rms.max():.2g} m at most, expected"
            f" {error.max():.2g} m"
        )
        .between(square, 0.5, 1.5),
        claim("Dense: so is h_sigma", "Noising data, sec. IV-B")
        .expected("within sigma of the kink, where smoothing acts, apart by less than half of it")
        .measured(f"{format_values(difference, '.2g')} m of {effect:.2g} m")
        .below(difference, _MATCH_SHARE * effect),
        claim("Dense: at the upper end g_sigma is off f_sigma", "our check")
        .expected("below it by 5 standard errors or more in every set")
        .measured(f"by {-end.max():.3g} or more over {end.size} sets and widths")
        .below(end, -5),
        claim("Dense: h_sigma agrees with g_sigma there", "our check")
        .expected("within sigma of the end less than half as far from g_sigma as from f_sigma")
        .measured(f"{format_values(off_g, '.2g')} m against {format_values(off_f, '.2g')} m")
        .below(off_g, _MATCH_SHARE * off_f),
    ]


def _sparse(data: xr.Dataset) -> list[Claim]:
    """Check models of the pusher learned from sparse data, between the first and the last datum."""
    sparse_data, u, widths = data.sel(regime="sparse"), data["u"].values, data["width"].values
    commands = data["pusher_data_sparse"].values
    within = (u >= max(commands.min(), 0.0)) & (u <= commands.max())
    h, g = sparse_data["pusher_h"].values[:, within], sparse_data["pusher_g"].values[within]
    f_sigma = data["f_sigma"].values[within]
    between_models, from_f_sigma = _rms(h - g), np.minimum(_rms(h - f_sigma), _rms(g - f_sigma))
    steep, flat = data["steepest"].values, data["flattest"].values
    stairs = np.mean((steep > 1.5) & (flat < 0.5), axis=1)
    narrow = widths <= data.attrs["sigma"]
    rms, effect = data["pusher_rms"].values, data["pusher_effect"].values
    return [
        claim("Sparse: h_sigma agrees with g_sigma, and neither with f_sigma", "Noising data, sec. IV-B")
        .expected("in contact, within the data: nearer to each other than either to f_sigma")
        .measured(f"{format_values(between_models, '.2g')} m against {format_values(from_f_sigma, '.2g')} m")
        .below(between_models, from_f_sigma),
        claim("Trained network and average show a good match, sparse and dense", "Noising data, sec. IV-B")
        .expected("rms over the noised data less than half of that of g_sigma - f")
        .measured(
            f"sparse {format_values(rms[0], '.2g')} m of {effect[0]:.2g} m,"
            f" dense {format_values(rms[1], '.2g')} m of {effect[1]:.2g} m"
        )
        .below(rms, _MATCH_SHARE * effect[:, None]),
        claim("Sparse: g_sigma climbs in steps", "our check")
        .expected(
            "slopes in contact below 0.5 rho and above 1.5 rho, where f_sigma has at most rho,"
            f" in {_SETS_SHARE:.0%} of the sets, up to the figure's sigma"
        )
        .measured(f"in {format_values(stairs, '.0%')} at sigma = {format_values(widths, 'g')} m")
        .at_least(stairs[narrow], _SETS_SHARE),
    ]


def _penetrating(data: xr.Dataset) -> list[Claim]:
    """Check models of the block learned from dense data, one step from states beyond the walls."""
    dense_data, x, sigma = data.sel(regime="dense"), data["x"].values, data.attrs["sigma"]
    inside, widths = data["least_inside"].values, list(data["width"].values)
    outside = np.abs(x) > 1
    h = dense_data["block_h"].values
    is_inside = np.all(np.abs(h) <= 1, axis=0)
    depth = np.abs(x) - 1
    failing_depth = depth[outside & ~is_inside].min(initial=depth.max())
    nearer = np.abs(h[:, outside]) < np.abs(x[outside])
    closed = _rms((dense_data["block_g"] - data["uniform_block"]).values)
    return [
        claim("Dense: penetrating states are moved inside by the average at the next step", "Noising data, sec. IV-C")
        .expected("inside in every set, at every depth")
        .measured(f"inside by {inside.min():.1e} m or more over {inside.size} sets and widths")
        .above(inside, 0),
        claim("Dense: the average is that of uniform states", "our check")
        .expected("rms below half of sigma from the closed form")
        .measured(f"{closed:.2g} m")
        .below(closed, _MATCH_SHARE * sigma),
        claim("Dense: the network moves them inside too", "Noising data, sec. IV-C, fig. 1")
        .expected(f"up to {depth.max():g} m deep, as in the figure")
        .measured(f"up to {failing_depth / sigma:.2g} sigma; {np.mean(is_inside[outside]):.0%} of the states drawn")
        .holds(is_inside[outside]),
        claim("Dense: the network moves them towards the inside", "our check")
        .expected("every penetrating state less far out after a step, by every network")
        .measured(f"{np.mean(nearer):.1%} of them")
        .holds(nearer),
        claim("Smaller sigma leaves them nearer to the wall", "our check")
        .expected("the least way inside grows with sigma, in the mean over sets")
        .measured(format_values(inside.mean(axis=1), ".1e") + " m at sigma = " + format_values(widths, "g") + " m")
        .above(np.diff(inside.mean(axis=1)), 0),
    ]


def _support(data: xr.Dataset) -> list[Claim]:
    """Check models of the block learned from sparse data, one step from states beyond the ends of the data."""
    x, sigma = data["x"].values, data.attrs["sigma"]
    sparse_data, states = data.sel(regime="sparse"), data["block_data_sparse"].values
    low, high = states.min(), states.max()
    outside = (x < low) | (x > high)
    g, h = sparse_data["block_g"].values, sparse_data["block_h"].values
    is_inside = (g[outside] >= low) & (g[outside] <= high)
    edge = np.where(x < low, low, high)
    distances = np.abs(g - edge)[outside]
    slope = np.abs(np.diff(g) / np.diff(x))[outside[1:] & (np.abs(x - edge) > 5 * sigma)[1:]]
    within_sigma = outside & (np.abs(x - edge) <= sigma)
    beyond = largest_value(np.maximum(low - h, h - high)[:, within_sigma])
    return [
        claim("Sparse: the average behaves as if walls stood at the ends of the data", "Noising data, sec. IV-C")
        .expected(
            "what lies beyond is put between the ends, within sigma of the nearer one, and the"
            " slope from 5 sigma on is below 0.05"
        )
        .measured(
            f"{np.mean(is_inside):.0%} of the states, up to {largest_value(distances) / sigma:.2g} sigma from the"
            f" end; slope up to {largest_value(slope):.2g}"
        )
        .holds(is_inside, largest_value(distances) < sigma, largest_value(slope) < 0.05),
        claim("Sparse: the network does too, sigma beyond the ends", "our check")
        .expected("between them, or less than half of sigma outside")
        .measured(f"{beyond / sigma:.2g} sigma outside at most")
        .below(beyond, _MATCH_SHARE * sigma),
    ]


def _rollouts(data: xr.Dataset) -> list[Claim]:
    """Check that rollouts from penetrating states end between the walls."""
    names = [f"{regime} {map_}" for regime in data["regime"].values for map_ in data["map"].values]
    path = np.abs(data["rollout"].values.reshape(len(names), -1, data.sizes["step"]))
    last = path[..., -1].max(axis=1) <= 1
    stays = np.array(
        [np.all(np.diff((distances <= 1).astype(int)) >= 0) and end for distances, end in zip(path, last, strict=True)]
    )
    longest = (path > 1).sum(axis=-1).max(axis=1)
    return [
        claim("Rollouts that begin in penetration come back and stay", "Noising data, sec. IV-C")
        .expected(f"inside the walls after {data['step'].values[-1]} steps, and never out again")
        .measured(f"{settings_text(names, stays)}: after at most {format_values(longest, 'd')} steps")
        .holds(stays, np.isfinite(path))
    ]
