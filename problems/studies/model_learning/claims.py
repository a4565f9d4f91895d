"""Claims of AM on one-step errors, on the learned parameters psi, and on noise and drag."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, claim, format_values, largest_value, settings_text, share_margin

_MODEL_LEARNING = "Adaptive barrier smoothing, sec. 7, model learning"
"""Citation in the claims that the paper makes."""
_PSI_TOLERANCE = 0.05
"""Relative error up to which a parameter in psi counts as identified."""
_COVERED_SHARE = 0.85
"""Minimum fraction of 95 % intervals that contain the true value; there are few, and they are not independent."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on the errors of both models and on psi, for exact data and for data with noise or drag."""
    return [*_errors(data), *_found(data), *_noise(data), *_drag(data)]


def _both(data: xr.Dataset, kind: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of models with learned psi and of networks, (n, seeds) each, for the n data sizes of psi."""
    errors = data["errors"].sel(data=kind, where=where)
    psi, network = errors.sel(model="psi").values, errors.sel(model="network").values
    learned = ~np.isnan(psi).all(axis=1)
    return psi[learned], network[learned]


def _errors(data: xr.Dataset) -> list[Claim]:
    sizes = [int(n) for n in data["transitions"].values]
    psi, network = _both(data, "exact", "contact")
    is_better = psi.max(axis=1) < network.min(axis=1)
    learned_sizes = sizes[: len(is_better)]
    ratio = network.min(axis=1) / psi.max(axis=1)
    psi_all, network_all = _both(data, "exact", "all")
    all_nets = data["errors"].sel(data="exact", where="all", model="network").values
    falls = np.median(all_nets, axis=1)
    return [
        claim("A complementarity model approximates contact better than a network", _MODEL_LEARNING)
        .expected("into contact, held out: the largest error over starts below the least of networks")
        .measured(f"{settings_text(learned_sizes, is_better)} transitions; by factors of {format_values(ratio, '.3g')}")
        .holds(is_better),
        claim("It does over all transitions too", _MODEL_LEARNING)
        .expected("likewise")
        .measured(
            f"{format_values(np.median(psi_all, axis=1), '.2g')}"
            f" against {format_values(np.median(network_all, axis=1), '.2g')}"
        )
        .below(psi_all.max(axis=1), network_all.min(axis=1)),
        claim("psi from few transitions predicts better than a network from many", "our check")
        .expected(f"{sizes[1]} transitions against {sizes[-1]}")
        .measured(f"{largest_value(psi_all[1:2]):.2g} against {all_nets[-1].min():.2g}")
        .below(psi_all[1:2], all_nets[-1].min()),
        claim("A network learns from more transitions", "our check")
        .expected(f"the median error from {sizes[-1]} is half of that from {sizes[0]} or less")
        .measured(format_values(falls, ".2g"))
        .at_most(falls[-1], 0.5 * falls[0]),
    ]


def _full(data: xr.Dataset, name: str, kind: str) -> np.ndarray:
    """Return the variable ``name`` of the dataset for psi learned from all transitions, (seeds, parameters)."""
    return data[name].sel(data=kind, transitions=data.attrs["data"]).values


def _found(data: xr.Dataset) -> list[Claim]:
    names, n = data["parameter"].values, data.attrs["data"]
    errors = np.abs(_full(data, "psi", "exact") - 1)
    worst = str(names[np.argmax(errors.max(axis=0))])
    high = _full(data, "high", "exact")
    is_bounded = np.isfinite(high)
    flight = data["flight"].values
    unknown = ", ".join(str(name) for name in names[np.isposinf(flight)])
    return [
        claim("All of psi is found from exact transitions", "our check")
        .expected(f"within {_PSI_TOLERANCE:.0%} of the truth from {n}, from every start")
        .measured(f"within {errors.max():.2g}, the worst is {worst}")
        .below(errors, _PSI_TOLERANCE),
        claim("So many transitions determine all of psi", "our check")
        .expected("bounded intervals from every start")
        .measured(f"{int(is_bounded.sum())} of {is_bounded.size}")
        .holds(is_bounded),
        claim("Those that touch nothing determine all but friction", "our check")
        .expected("unbounded at the truth: friction alone")
        .measured(f"unbounded: {unknown or 'none'}")
        .holds(unknown == "friction"),
    ]


def _noise(data: xr.Dataset) -> list[Claim]:
    psi, network = _both(data, "noise", "all")
    low, high = _full(data, "low", "noise"), _full(data, "high", "noise")
    holds_truth = (low <= 1) & (high >= 1)
    errors = np.abs(_full(data, "psi", "noise") - 1)
    return [
        claim("Where transitions are noisy psi still predicts better", "our check")
        .expected(f"noise of {data.attrs['noise']:g} deviations of a step: as above")
        .measured(
            f"{format_values(np.median(psi, axis=1), '.2g')} against {format_values(np.median(network, axis=1), '.2g')}"
        )
        .below(psi.max(axis=1), network.min(axis=1)),
        claim("Intervals of noisy transitions hold the truth", "our check")
        .expected(f"{_COVERED_SHARE:.0%} of those of 95 % or more")
        .measured(f"{int(holds_truth.sum())} of {holds_truth.size}; off by {errors.max():.2g} at most")
        .holds(holds_truth.mean() >= _COVERED_SHARE, margin=share_margin(holds_truth, _COVERED_SHARE)),
    ]


def _drag(data: xr.Dataset) -> list[Claim]:
    (psi, network), (psi_exact, network_exact) = _both(data, "drag", "all"), _both(data, "exact", "all")
    low, high = _full(data, "low", "drag"), _full(data, "high", "drag")
    holds_truth = (low <= 1) & (high >= 1)
    errors = np.abs(_full(data, "psi", "drag") - 1).max(axis=1)
    lead = [np.median(b[-1:]) / np.median(a[-1:]) for a, b in ((psi, network), (psi_exact, network_exact))]
    return [
        claim("A drag that the model lacks removes psi's advantage over a network", "our check")
        .expected("less than a tenth of it is left, the network's error over psi's")
        .measured(f"{lead[0]:.2g} of {lead[1]:.2g}")
        .below(lead[0], 0.1 * lead[1]),
        claim("There the intervals hold the truth", "our check")
        .expected(f"{_COVERED_SHARE:.0%} of those of 95 % or more")
        .measured(f"{int(holds_truth.sum())} of {holds_truth.size}; off by {format_values(errors, '.2g')}")
        .holds(holds_truth.mean() >= _COVERED_SHARE, margin=share_margin(holds_truth, _COVERED_SHARE)),
    ]
