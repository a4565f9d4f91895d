"""What N0's data say of lemmas 1 to 3 and of what sec. III and IV build on them."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, listed, over

_PLACE = "Noising data, "
_NEAR = 2.0
"""Distance from an end of the data over sigma within which g_sigma is off f_sigma."""
_FEW, _USUAL = 10.0, 0.2
"""Neighbours below which an average is hardly one; the sigma that papers' data are given."""

_MANY = 400.0
"""Neighbours that are enough for their number to be told from one draw of data."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Lemmas, walls, score, networks, ends and dimensions, in this order."""
    return [
        *_lemmas(data),
        *_walls(data),
        *_rollouts(data),
        *_networks(data),
        *_ends(data),
        *_neighbours(data),
    ]


def _lemmas(data: xr.Dataset) -> list[Claim]:
    off, law, spacing = data["sum_error"].values, data["sum_law"].values, data["spacing"].values
    share = (off / law)[..., spacing <= 0.25]
    largest = off.max(axis=(0, 1, 2))
    ratio = data["higher"] / data["change"] ** 2
    other = data["others"].values
    score = data["score_error"].values
    found = [
        Claim(
            "On uniform data g_sigma is f_sigma",
            _PLACE + "lemma 1",
            "apart by the error of the sum over data D apart, up to rho D²/(12 sqrt(2 pi) sigma),"
            " within 5 % of it for D <= sigma/4",
            f"{share.min():.3f} to {share.max():.3f} of it over {share.size} settings; "
            + listed(largest, ".1e")
            + " rho sigma at D = "
            + listed(spacing, "g")
            + " sigma",
            bool(np.all(np.abs(share - 1) < 0.05) and np.all(np.diff(largest) < 0)),
        ),
    ]
    for sentence, source, mark in (
        ("g_sigma minimises the noised risk of a density", "lemma 2", False),
        ("The weighted average minimises the noised risk of data", "lemma 3", True),
    ):
        own = [name for name in data["case"].values if ("data" in str(name)) == mark]
        these = ratio.sel(case=own).values
        found.append(
            Claim(
                sentence,
                _PLACE + source,
                "any perturbation p raises it, by E p², within 1e-9 of that",
                f"raised by {these.min():.10f} to {these.max():.10f} E p² by"
                f" {these.size} perturbations of {', '.join(map(str, own))}",
                bool(np.all(these > 0) and np.all(np.abs(these - 1) < 1e-9)),
            )
        )
    return [
        *found,
        Claim(
            "f, f_sigma and the nearest datum have a higher noised risk",
            _PLACE + "sec. III-B",
            "higher on all data and densities",
            "by at least "
            + ", ".join(
                f"{name} {low:.1%}" for name, low in zip(data["candidate"].values, other.min((0, 1)), strict=True)
            )
            + " of its risk",
            bool(np.all(other > 0)),
        ),
        Claim(
            "For f(x) = x, g_sigma = x + sigma² grad log p_sigma",
            "empirical Bayes, our check",
            "equal to differences of log p_sigma, within 1e-8 sigma",
            f"off by {score.max():.1e} sigma at most, in " + listed(data["dimension"].values, "d") + " dimensions",
            bool(np.all(score < 1e-8)),
        ),
    ]


def _walls(data: xr.Dataset) -> list[Claim]:
    spacing, depth = data["spacing"].values, data["depth"].values
    share = (data["walls_error"] / data["walls_law"]).values[:, spacing <= 0.25]
    inside, slope = data["inside"].values, data["slope_outside"].values
    wide = (data["gap"].values[:, None] / data["width"].values >= 5)[..., None]
    # Bounds of Mills' ratio by Sampford and by Birnbaum, for walls many sigma apart.
    low, high = (np.sqrt(depth**2 + 8) - depth) / 4, (np.sqrt(depth**2 + 4) - depth) / 2
    between = (inside >= low * (1 - 1e-6)) & (inside <= high * (1 + 1e-6))
    far = depth >= 10
    tends = np.abs(slope[..., far] * depth[far] ** 2 - 1)
    return [
        Claim(
            "Between walls g_sigma is the mean of a truncated normal",
            _PLACE + "sec. IV-C",
            "evenly spaced data miss it by the midpoint rule's error, within 5 % for D <= sigma/4",
            f"{share.min():.3f} to {share.max():.3f} of that error, at sigma = "
            + listed(data["width"].values, "g")
            + " m",
            bool(np.all(np.abs(share - 1) < 0.05)),
        ),
        Claim(
            "A penetrating state is mapped back inside in one step",
            _PLACE + "sec. IV-C",
            "inside by (sqrt(s² + 8) - s)/4 to (sqrt(s² + 4) - s)/2 sigma, s sigma the"
            " penetration, or inside at least where the walls are less than 5 sigma apart",
            f"inside by {inside.min():.4g} sigma or more, within these bounds at"
            f" {np.sum(between & wide)} of {np.sum(wide) * depth.size} settings; penetration up"
            f" to {depth.max():g} sigma",
            bool(np.all(inside > 0) and np.all(between | ~wide)),
        ),
        Claim(
            "The slope of g_sigma tends to 0 outside",
            "our check",
            "falls with the penetration, as (sigma/penetration)² within 6 % from 10 sigma on",
            f"{slope[..., 0].max():.3f} at the wall, {slope[..., far].max():.4f} at"
            f" {depth[far][0]:g} sigma, off by {tends.max():.1%} there",
            bool(np.all(np.diff(slope, axis=-1) < 0) and np.all(tends < 0.06)),
        ),
    ]


def _rollouts(data: xr.Dataset) -> list[Claim]:
    fixed, outwards = data["fixed_points"].values, data["outwards"].values
    ends, centre, climb = (data[name].values for name in ("attractors", "off_centre", "climb"))
    sizes = data["sample"].values
    return [
        Claim(
            "Uniform data have one fixed point, the middle of the walls",
            "our check",
            "g_sigma(x) - x changes its sign once, and never leads outwards",
            f"changes {listed(np.unique(fixed), 'g')} times in {fixed.size} settings;"
            f" {np.mean(outwards):.0%} of the states move outwards",
            bool(np.all(fixed == 1) and np.all(outwards == 0)),
        ),
        Claim(
            "So have random states between the walls",
            "our check",
            "one state at which rollouts end, within sigma of the middle",
            f"{listed(ends, 'g')} such states of {listed(sizes, 'd')} data, up to {centre.max():.2f} m from the middle",
            bool(np.all(ends == 1) and np.all(centre < data.attrs["sigma"])),
        ),
        Claim(
            "Every step of theirs climbs the density of the noised data",
            "our check",
            "log p_sigma grows",
            f"by {climb.min():.1e} at least",
            bool(np.all(climb > 0)),
        ),
    ]


def _networks(data: xr.Dataset) -> list[Claim]:
    error, pairs = data["network_error"].values, data["pairs"].values
    units, effect = data["units"].values, float(data["noising_effect"])
    middle = np.median(error, axis=-1)
    rates = np.polyfit(np.log(pairs), np.log(error[-1]), 1)[0] if np.all(error > 0) else [np.nan]
    rate, doubt = np.mean(rates), np.std(rates)
    last = middle[:, -1]
    return [
        Claim(
            "Networks trained on noised data converge to g_sigma",
            _PLACE + "sec. III, IV-B",
            "off by less than half of what noising changes, at the most pairs and units",
            f"{last[-1]:.2g} m of {effect:.2g} m, medians over draws",
            bool(last[-1] < effect / 2),
        ),
        Claim(
            "The more pairs the nearer",
            "our check",
            "falls at every count, with an exponent below -1/4; independent draws have -1/2",
            f"{rate:.2f}, deviation {doubt:.2f} over draws: "
            + listed(middle[-1], ".1e")
            + " m at "
            + listed(pairs, "d")
            + " pairs",
            bool(rate < -0.25 and np.all(np.diff(middle[-1]) < 0)),
        ),
        Claim(
            "A network too narrow stays away, however many pairs",
            "our check",
            "the narrowest half as far again off as the widest, at the most pairs",
            listed(last, ".1e") + " m at " + listed(units, "d") + " units a layer",
            bool(last[0] > 1.5 * last[-1]),
        ),
    ]


def _ends(data: xr.Dataset) -> list[Claim]:
    bias, distance = np.abs(data["bias"].values), data["distance"].values
    near = distance <= _NEAR
    squares = bias[0] ** 2
    share = squares[:, near].sum(axis=-1) / squares.sum(axis=-1)
    beyond, at_end = bias[0][:, ~near].max(axis=-1), bias[..., 0]
    felt = np.all(at_end > 0.1, axis=1)
    return [
        Claim(
            "g_sigma differs from f_sigma within 2 sigma of the ends of the data",
            _PLACE + "fig. 1",
            "by sqrt(2/pi) rho sigma at the end, 99 % of the square of it"
            " within 2 sigma, below 6 % of rho sigma beyond",
            f"{listed(at_end[0], '.4f')} rho sigma at the end, {share.min():.2%} within, up to"
            f" {beyond.max():.3f} beyond, at sigma = " + listed(data["width"].values, "g") + " m",
            bool(
                np.allclose(at_end[0], np.sqrt(2 / np.pi), rtol=1e-6) and np.all(share > 0.99) and np.all(beyond < 0.06)
            ),
        ),
        Claim(
            "It does at both ends",
            _PLACE + "fig. 1",
            "above 0.1 rho sigma at each",
            f"{over(list(data['end'].values), felt)}: up to {listed(at_end.max(axis=1), '.1e')}"
            " rho sigma; f is constant where the pusher stays away",
            bool(np.all(felt)),
        ),
    ]


def _neighbours(data: xr.Dataset) -> list[Claim]:
    found, law = data["neighbours"].values, data["neighbours_law"].values
    dims, widths = data["dim"].values, data["normalised"].values
    # The number near one query is random with a relative deviation of its inverse square root.
    many = law >= _MANY
    apart = np.abs(found / law - 1)[many]
    column = int(np.argmin(np.abs(widths - _USUAL)))
    few = dims[found[:, column] < _FEW]
    task = data["task_neighbours"].isel(normalised=column)
    alone, tube = (task.sel(drawn=name).values for name in data["drawn"].values)
    names = [str(name) for name in data["problem"].values]
    sizes = listed(data["task_size"].values, "g")
    return [
        Claim(
            "The data near a query fall off with the dimension d as sigma^d",
            "our check",
            "n (2 sqrt(pi) sigma/length)^d effective neighbours, within 15 %, three deviations"
            f" of a count of {_MANY:g}, where it is that or more",
            f"off by {apart.max(initial=0):.1%} at most, at {apart.size} settings",
            bool(apart.size and np.all(apart < 3 / np.sqrt(_MANY))),
        ),
        Claim(
            "Uniform data are too sparse for the average in the dimensions of pushing",
            "our check",
            f"fewer than {_FEW:g} neighbours at sigma = {_USUAL:g}",
            f"from {listed(few[:1], 'd')} dimensions on; along the task "
            + ", ".join(f"{n}: {a:.1f}" for n, a in zip(names, alone, strict=True))
            + f" in {sizes} dimensions, of {data.attrs['n_samples']} data",
            bool(np.all(alone < _FEW) and few.size and few.min() <= data["task_size"].min()),
        ),
        Claim(
            "With half of the data in the tube there are more",
            "our check",
            f"twice as many at sigma = {_USUAL:g}",
            ", ".join(f"{n}: {a:.1f} become {t:.1f}" for n, a, t in zip(names, alone, tube, strict=True)),
            bool(np.all(tube >= 2 * alone)),
        ),
        Claim(
            "That is enough",
            "our check",
            f"{_FEW:g} or more at sigma = {_USUAL:g}",
            f"{over(names, tube >= _FEW)}: " + listed(tube, ".1f"),
            bool(np.all(tube >= _FEW)),
        ),
    ]
