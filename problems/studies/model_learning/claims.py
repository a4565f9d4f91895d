"""What AM's data say of the paper's model learning."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, largest, listed, over, share_margin

_PLACE = "Adaptive barrier smoothing, sec. 7, model learning"
_NEAR = 0.05
"""Distance of psi from the truth that counts as found."""
_COVERED = 0.85
"""Part of the intervals of 95 % that must hold the truth: they are few and not independent."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Errors of both models, then psi, then what becomes of both where data are not exact."""
    return [*_errors(data), *_found(data), *_noise(data), *_drag(data)]


def _both(data: xr.Dataset, kind: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors (transitions, seeds) of psi and of networks, where both have learned."""
    at = data["errors"].sel(data=kind, where=where)
    psi, network = at.sel(model="psi").values, at.sel(model="network").values
    learned = ~np.isnan(psi).all(axis=1)
    return psi[learned], network[learned]


def _errors(data: xr.Dataset) -> list[Claim]:
    sizes = [int(n) for n in data["transitions"].values]
    psi, network = _both(data, "exact", "contact")
    below = psi.max(axis=1) < network.min(axis=1)
    tried = sizes[: len(below)]
    ratio = network.min(axis=1) / psi.max(axis=1)
    everywhere, nets = _both(data, "exact", "all")
    all_nets = data["errors"].sel(data="exact", where="all", model="network").values
    falls = np.median(all_nets, axis=1)
    return [
        Claim("A complementarity model approximates contact better than a network", _PLACE,
              "into contact, held out: the largest error over starts below the least of networks",
              f"{over(tried, below)} transitions; by factors of {listed(ratio, '.3g')}",
              bool(below.size and np.all(below))),
        Claim("So it does over all transitions", _PLACE,
              "likewise", f"{listed(np.median(everywhere, axis=1), '.2g')} against"
              f" {listed(np.median(nets, axis=1), '.2g')}",
              bool(nets.size and np.all(everywhere.max(axis=1) < nets.min(axis=1)))),
        Claim("psi of few transitions is ahead of a network of many", "our check",
              f"{sizes[1]} transitions against {sizes[-1]}",
              f"{largest(everywhere[1:2]):.2g} against {all_nets[-1].min():.2g}",
              bool(largest(everywhere[1:2]) < all_nets[-1].min())),
        Claim("A network learns from more transitions", "our check",
              f"the median error from {sizes[-1]} is half of that from {sizes[0]} or less",
              listed(falls, ".2g"), bool(falls[-1] <= 0.5 * falls[0])),
    ]  # fmt: skip


def _full(data: xr.Dataset, name: str, kind: str) -> np.ndarray:
    """Of psi at the full number of transitions, (seeds, parameters)."""
    return data[name].sel(data=kind, transitions=data.attrs["data"]).values


def _found(data: xr.Dataset) -> list[Claim]:
    names, n = data["parameter"].values, data.attrs["data"]
    off = np.abs(_full(data, "psi", "exact") - 1)
    worst = str(names[np.argmax(off.max(axis=0))])
    high = _full(data, "high", "exact")
    known = np.isfinite(high)
    flight = data["flight"].values
    unknown = ", ".join(str(name) for name in names[np.isposinf(flight)])
    return [
        Claim("All of psi is found from exact transitions", "our check",
              f"within {_NEAR:.0%} of the truth from {n}, from every start",
              f"within {off.max():.2g}, the worst is {worst}",
              bool(off.size and np.all(off < _NEAR))),
        Claim("So many transitions determine all of psi", "our check",
              "bounded intervals from every start",
              f"{int(known.sum())} of {known.size}", bool(np.all(known))),
        Claim("Those that touch nothing determine all but friction", "our check",
              "unbounded at the truth: friction alone", f"unbounded: {unknown or 'none'}",
              bool(unknown == "friction")),
    ]  # fmt: skip


def _noise(data: xr.Dataset) -> list[Claim]:
    psi, network = _both(data, "noise", "all")
    low, high = _full(data, "low", "noise"), _full(data, "high", "noise")
    held = (low <= 1) & (high >= 1)
    off = np.abs(_full(data, "psi", "noise") - 1)
    return [
        Claim("Where transitions are noisy psi still predicts better", "our check",
              f"noise of {data.attrs['noise']:g} deviations of a step: as above",
              f"{listed(np.median(psi, axis=1), '.2g')} against"
              f" {listed(np.median(network, axis=1), '.2g')}",
              bool(psi.size and np.all(psi.max(axis=1) < network.min(axis=1)))),
        Claim("Intervals of noisy transitions hold the truth", "our check",
              f"{_COVERED:.0%} of those of 95 % or more",
              f"{int(held.sum())} of {held.size}; off by {off.max():.2g} at most",
              bool(held.mean() >= _COVERED), share_margin(held, _COVERED)),
    ]  # fmt: skip


def _drag(data: xr.Dataset) -> list[Claim]:
    (psi, network), (own, other) = _both(data, "drag", "all"), _both(data, "exact", "all")
    low, high = _full(data, "low", "drag"), _full(data, "high", "drag")
    held = (low <= 1) & (high >= 1)
    off = np.abs(_full(data, "psi", "drag") - 1).max(axis=1)
    lead = [np.median(b[-1:]) / np.median(a[-1:]) for a, b in ((psi, network), (own, other))]
    return [
        Claim("A drag that the model lacks takes its lead over a network", "our check",
              "less than a tenth of it is left, the network's error over psi's",
              f"{lead[0]:.2g} of {lead[1]:.2g}", bool(lead[0] < 0.1 * lead[1])),
        Claim("There the intervals hold the truth", "our check",
              f"{_COVERED:.0%} of those of 95 % or more",
              f"{int(held.sum())} of {held.size}; off by {listed(off, '.2g')}",
              bool(held.mean() >= _COVERED), share_margin(held, _COVERED)),
    ]  # fmt: skip
