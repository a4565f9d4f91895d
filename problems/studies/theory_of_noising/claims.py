"""Claims of N0 on Suh et al. 2023, lemmas 1 to 3, sec. III and sec. IV."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, claim, format_values, settings_text

_END_DISTANCE = 2.0
"""Distance from an end of the data, in units of sigma, below which g_sigma differs from f_sigma."""
_FEW_NEIGHBOURS = 10.0
"""Number of effective neighbours below which data are too sparse for averages."""
_USUAL_SIGMA = 0.2
"""Usual ratio of the standard deviations of noise and data."""
_MANY_NEIGHBOURS = 400.0
"""Number of effective neighbours above which random draws of the data change this number by at most 5 %."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the lemmas, on walls, rollouts and networks, on the ends of the data, and on dimensions."""
    return [*_lemmas(data), *_walls(data), *_rollouts(data), *_networks(data), *_ends(data), *_neighbours(data)]


def _lemmas(data: xr.Dataset) -> list[Claim]:
    errors, law, spacing = data["sum_error"].values, data["sum_law"].values, data["spacing"].values
    share = (errors / law)[..., spacing <= 0.25]
    largest = errors.max(axis=(0, 1, 2))
    ratio = data["higher"] / data["change"] ** 2
    others = data["others"].values
    score = data["score_error"].values
    results = [
        claim("On uniform data g_sigma is f_sigma", "Noising data, lemma 1")
        .expected(
            "apart by the error of the sum over data D apart, up to rho D²/(12 sqrt(2 pi) sigma),"
            " within 5 % of it for D <= sigma/4"
        )
        .measured(
            f"{share.min():.3f} to {share.max():.3f} of it over {share.size} settings; "
            + format_values(largest, ".1e")
            + " rho sigma at D = "
            + format_values(spacing, "g")
            + " sigma"
        )
        .holds(np.abs(share - 1) < 0.05, np.diff(largest) < 0)
    ]
    for sentence, source, mark in (
        ("g_sigma minimises the noised risk of a density", "lemma 2", False),
        ("The weighted average minimises the noised risk of data", "lemma 3", True),
    ):
        cases = [name for name in data["case"].values if ("data" in str(name)) == mark]
        ratios = ratio.sel(case=cases).values
        results.append(
            claim(sentence, f"Noising data, {source}")
            .expected("any perturbation p raises it, by E p², within 1e-9 of that")
            .measured(
                f"raised by {ratios.min():.10f} to {ratios.max():.10f} E p² by"
                f" {ratios.size} perturbations of {', '.join(map(str, cases))}"
            )
            .holds(ratios > 0, np.abs(ratios - 1) < 1e-9)
        )
    return [
        *results,
        claim("f, f_sigma and the nearest datum have a higher noised risk", "Noising data, sec. III-B")
        .expected("higher on all data and densities")
        .measured(
            "by at least "
            + ", ".join(
                f"{name} {low:.1%}" for name, low in zip(data["candidate"].values, others.min((0, 1)), strict=True)
            )
            + " of its risk"
        )
        .above(others, 0),
        claim("For f(x) = x, g_sigma = x + sigma² grad log p_sigma", "empirical Bayes, our check")
        .expected("equal to differences of log p_sigma, within 1e-8 sigma")
        .measured(
            f"off by {score.max():.1e} sigma at most, in "
            + format_values(data["dimension"].values, "d")
            + " dimensions"
        )
        .below(score, 1e-8),
    ]


def _walls(data: xr.Dataset) -> list[Claim]:
    spacing, depth = data["spacing"].values, data["depth"].values
    share = (data["walls_error"] / data["walls_law"]).values[:, spacing <= 0.25]
    inside, slope = data["inside"].values, data["slope_outside"].values
    wide = (data["gap"].values[:, None] / data["width"].values >= 5)[..., None]
    # Bounds of Mills' ratio by Sampford and by Birnbaum, for walls many sigma apart.
    low, high = (np.sqrt(depth**2 + 8) - depth) / 4, (np.sqrt(depth**2 + 4) - depth) / 2
    is_between = (inside >= low * (1 - 1e-6)) & (inside <= high * (1 + 1e-6))
    is_deep = depth >= 10
    tends = np.abs(slope[..., is_deep] * depth[is_deep] ** 2 - 1)
    return [
        claim("Between walls g_sigma is the mean of a truncated normal", "Noising data, sec. IV-C")
        .expected("evenly spaced data miss it by the midpoint rule's error, within 5 % for D <= sigma/4")
        .measured(
            f"{share.min():.3f} to {share.max():.3f} of that error, at sigma = "
            + format_values(data["width"].values, "g")
            + " m"
        )
        .equals(share, 1, within=0.05),
        claim("A penetrating state is mapped back inside in one step", "Noising data, sec. IV-C")
        .expected(
            "inside by (sqrt(s² + 8) - s)/4 to (sqrt(s² + 4) - s)/2 sigma, s sigma the"
            " penetration, or inside at least where the walls are less than 5 sigma apart"
        )
        .measured(
            f"inside by {inside.min():.4g} sigma or more, within these bounds at"
            f" {np.sum(is_between & wide)} of {np.sum(wide) * depth.size} settings; penetration up"
            f" to {depth.max():g} sigma"
        )
        .holds(inside > 0, is_between | ~wide),
        claim("The slope of g_sigma tends to 0 outside", "our check")
        .expected("falls with the penetration, as (sigma/penetration)² within 6 % from 10 sigma on")
        .measured(
            f"{slope[..., 0].max():.3f} at the wall, {slope[..., is_deep].max():.4f} at"
            f" {depth[is_deep][0]:g} sigma, off by {tends.max():.1%} there"
        )
        .holds(np.diff(slope, axis=-1) < 0, tends < 0.06),
    ]


def _rollouts(data: xr.Dataset) -> list[Claim]:
    fixed, outwards = data["fixed_points"].values, data["outwards"].values
    ends, centre, climb = (data[name].values for name in ("attractors", "off_centre", "climb"))
    sizes = data["sample"].values
    return [
        claim("Uniform data have one fixed point, the middle of the walls", "our check")
        .expected("g_sigma(x) - x changes its sign once, and never leads outwards")
        .measured(
            f"changes {format_values(np.unique(fixed), 'g')} times in {fixed.size} settings;"
            f" {np.mean(outwards):.0%} of the states move outwards"
        )
        .holds(fixed == 1, outwards == 0),
        claim("So have random states between the walls", "our check")
        .expected("one state at which rollouts end, within sigma of the middle")
        .measured(
            f"{format_values(ends, 'g')} such states of {format_values(sizes, 'd')} data,"
            f" up to {centre.max():.2f} m from the middle"
        )
        .holds(ends == 1, centre < data.attrs["sigma"]),
        claim("Every step of theirs climbs the density of the noised data", "our check")
        .expected("log p_sigma grows")
        .measured(f"by {climb.min():.1e} at least")
        .above(climb, 0),
    ]


def _networks(data: xr.Dataset) -> list[Claim]:
    error, pairs = data["network_error"].values, data["pairs"].values
    units, effect = data["units"].values, float(data["noising_effect"])
    middle = np.median(error, axis=-1)
    rates = np.polyfit(np.log(pairs), np.log(error[-1]), 1)[0] if np.all(error > 0) else [np.nan]
    rate, doubt = np.mean(rates), np.std(rates)
    last = middle[:, -1]
    return [
        claim("Networks trained on noised data converge to g_sigma", "Noising data, sec. III, IV-B")
        .expected("off by less than half of what noising changes, at the most pairs and units")
        .measured(f"{last[-1]:.2g} m of {effect:.2g} m, medians over draws")
        .below(last[-1], effect / 2),
        claim("More pairs bring it nearer", "our check")
        .expected("falls at every count, with an exponent below -1/4; independent draws have -1/2")
        .measured(
            f"{rate:.2f}, deviation {doubt:.2f} over draws: "
            + format_values(middle[-1], ".1e")
            + " m at "
            + format_values(pairs, "d")
            + " pairs"
        )
        .holds(rate < -0.25, np.diff(middle[-1]) < 0),
        claim("A network too narrow stays away, however many pairs", "our check")
        .expected("the narrowest half as far again off as the widest, at the most pairs")
        .measured(format_values(last, ".1e") + " m at " + format_values(units, "d") + " units a layer")
        .above(last[0], 1.5 * last[-1]),
    ]


def _ends(data: xr.Dataset) -> list[Claim]:
    bias, distance = np.abs(data["bias"].values), data["distance"].values
    is_near = distance <= _END_DISTANCE
    squares = bias[0] ** 2
    share = squares[:, is_near].sum(axis=-1) / squares.sum(axis=-1)
    beyond, at_end = bias[0][:, ~is_near].max(axis=-1), bias[..., 0]
    is_biased = np.all(at_end > 0.1, axis=1)
    return [
        claim("g_sigma differs from f_sigma within 2 sigma of the ends of the data", "Noising data, fig. 1")
        .expected(
            "by sqrt(2/pi) rho sigma at the end, 99 % of the square of it within 2 sigma, below 6 % of rho sigma beyond"
        )
        .measured(
            f"{format_values(at_end[0], '.4f')} rho sigma at the end, {share.min():.2%} within, up to"
            f" {beyond.max():.3f} beyond, at sigma = " + format_values(data["width"].values, "g") + " m"
        )
        .holds(np.allclose(at_end[0], np.sqrt(2 / np.pi), rtol=1e-6), share > 0.99, beyond < 0.06),
        claim("It does at both ends", "Noising data, fig. 1")
        .expected("above 0.1 rho sigma at each")
        .measured(
            f"{settings_text(list(data['end'].values), is_biased)}: up to {format_values(at_end.max(axis=1), '.1e')}"
            " rho sigma; f is constant where the pusher stays away"
        )
        .holds(is_biased),
    ]


def _neighbours(data: xr.Dataset) -> list[Claim]:
    counts, law = data["neighbours"].values, data["neighbours_law"].values
    dims, widths = data["dim"].values, data["normalised"].values
    # The count near one query has the relative standard deviation 1/sqrt(count).
    is_many = law >= _MANY_NEIGHBOURS
    misfit = np.abs(counts / law - 1)[is_many]
    column = int(np.argmin(np.abs(widths - _USUAL_SIGMA)))
    sparse_dimensions = dims[counts[:, column] < _FEW_NEIGHBOURS]
    task = data["task_neighbours"].isel(normalised=column)
    ranges_alone, tube = (task.sel(drawn=name).values for name in data["drawn"].values)
    names = [str(name) for name in data["problem"].values]
    sizes = format_values(data["task_size"].values, "g")
    return [
        claim("The data near a query fall off with the dimension d as sigma^d", "our check")
        .expected(
            "n (2 sqrt(pi) sigma/length)^d effective neighbours, within 15 %, three deviations"
            f" of a count of {_MANY_NEIGHBOURS:g}, where it is that or more"
        )
        .measured(f"off by {misfit.max(initial=0):.1%} at most, at {misfit.size} settings")
        .below(misfit, 3 / np.sqrt(_MANY_NEIGHBOURS)),
        claim("Uniform data are too sparse for the average in the dimensions of pushing", "our check")
        .expected(f"fewer than {_FEW_NEIGHBOURS:g} neighbours at sigma = {_USUAL_SIGMA:g}")
        .measured(
            f"from {format_values(sparse_dimensions[:1], 'd')} dimensions on; along the task "
            + ", ".join(f"{n}: {a:.1f}" for n, a in zip(names, ranges_alone, strict=True))
            + f" in {sizes} dimensions, of {data.attrs['n_samples']} data"
        )
        .holds(ranges_alone < _FEW_NEIGHBOURS, sparse_dimensions[:1] <= float(data["task_size"].min())),
        claim("There are more with half of the data near the line from start to goal", "our check")
        .expected(f"twice as many at sigma = {_USUAL_SIGMA:g}")
        .measured(", ".join(f"{n}: {a:.1f} become {t:.1f}" for n, a, t in zip(names, ranges_alone, tube, strict=True)))
        .at_least(tube, 2 * ranges_alone),
        claim("That is enough", "our check")
        .expected(f"{_FEW_NEIGHBOURS:g} or more at sigma = {_USUAL_SIGMA:g}")
        .measured(f"{settings_text(names, tube >= _FEW_NEIGHBOURS)}: " + format_values(tube, ".1f"))
        .at_least(tube, _FEW_NEIGHBOURS),
    ]
