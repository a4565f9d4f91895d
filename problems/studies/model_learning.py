"""AM: one-step errors over transitions, psi against a network, and psi with its intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import xarray as xr

from dynamics.contact import Exact
from dynamics.learned.training import train
from dynamics.learned.transitions import Origin, Samples
from ocp.learning.explorer import Buffer, Explorer, random_transitions
from ocp.learning.identify import OneStepLoss, identify, intervals
from ocp.learning.random_search import RandomSearch
from ocp.problem.task import Task
from problems.studies.progress import track_items
from problems.studies.study import (
    Claim,
    FinishedParts,
    StudyParams,
    claim,
    dataset,
    format_values,
    largest_value,
    setting,
    settings_text,
    share_margin,
)
from problems.tasks.registry import get

NOTES = (
    "The paper names no parameters, ranges or sizes: here four masses, four inertias, friction,"
    " spring and damping of the joints start at random between half and twice the truth.",
    "The model's class holds the truth where data are exact; so each figure stands beside"
    " transitions with noise, and beside a hopper with a drag that the model does not know.",
    "Errors are means over held-out transitions of |x' - f(x, u)|, which adds m, rad, m/s and"
    " rad/s as the paper's does; the search weighs each coordinate by how much it moves.",
    "Intervals: 95 % of the minima of resampled transitions, out to what was found.",
)
QUICK = {"seeds": 1, "held": 100, "iterations": 20, "rows": 32, "units": 32, "epochs": 20}
RESUMES = True


WHERE = ("all", "flight", "contact")
"""Groups of held-out transitions that errors are averaged over."""
MODELS = ("psi", "network")
"""Models that are compared."""
MIXED = "m, rad, m/s, rad/s"
"""Unit of one-step errors, whose coordinates are added as the paper does."""


class Params(StudyParams):
    """Parameters of AM; the network's are the authors' code's, the others our choice."""

    data: int = setting(2000, "1", "transitions, of which a 40th, a 10th, a 4th are fewer", least=400)
    held: int = setting(1000, "1", "held-out transitions", least=50)
    seeds: int = setting(3, "1", "starts of psi and of networks", least=1, most=20)
    noise: float = setting(0.01, "1", "noise on next states, in deviations of steps", above=0)
    spread: float = setting(2.0, "1", "largest factor between truth and start", above=1)
    candidates: int = setting(32, "1", "candidates an iteration", least=4)
    iterations: int = setting(120, "1", "iterations a pass of the search, two passes", least=1)
    rows: int = setting(128, "1", "transitions that judge an iteration", least=1)
    units: int = setting(200, "1", "units in each of four layers", "authors' code", least=1)
    epochs: int = setting(300, "1", "passes over the data in training, at most", least=1)


def transition_counts(params: Params) -> list[int]:
    """Return the numbers of transitions; only networks learn from the last, four times the full number."""
    return [params.data // 40, params.data // 10, params.data // 4, params.data, 4 * params.data]


def run(params: Params, pieces: FinishedParts) -> xr.Dataset:
    """Learn from exact transitions over their number, and from noise and drag at the full number."""
    sizes = transition_counts(params)
    errors = np.full((len(DATA), len(MODELS), len(sizes), params.seeds, len(WHERE)), np.nan)
    shape = len(DATA), len(sizes), params.seeds, len(PSI)
    psi_values = {name: np.full(shape, np.nan) for name in ("psi", "low", "high")}
    search_means = np.full((params.seeds, 2 * (params.iterations + 1), len(PSI)), np.nan)
    still, touched = np.empty((len(DATA), len(WHERE))), np.empty(len(DATA))
    flight = np.empty(len(PSI))
    for i, kind in enumerate(DATA):
        source = TransitionData.of(kind, params, sizes[-1])
        still[i], touched[i] = source.still, source.touched.mean()
        if kind == DATA[0]:
            flight = pieces.get("flight", partial(in_flight, source))["high"]
        for j, n in enumerate(sizes):
            if kind != DATA[0] and n != params.data:
                continue
            for seed in track_items(f"{kind}, {n} transitions: seeds", range(params.seeds)):
                key = f"{kind}-{n}-{seed}"
                make = partial(by_network, source, n, seed, params)
                errors[i, 1, j, seed] = pieces.get(f"network-{key}", make)["errors"]
                if n > params.data:
                    continue
                piece = pieces.get(f"psi-{key}", partial(by_psi, source, n, seed, params))
                errors[i, 0, j, seed] = piece["errors"]
                for name, values in psi_values.items():
                    values[i, j, seed] = piece[name]
                if kind == DATA[0] and n == params.data:
                    search_means[seed, : len(piece["way"])] = piece["way"]
    dimensions = ("data", "transitions", "seed", "parameter")
    return dataset(
        {
            "errors": (
                ("data", "model", "transitions", "seed", "where"),
                errors,
                MIXED,
                "mean one-step error, held out",
            ),
            "still": (("data", "where"), still, MIXED, "mean one-step error if nothing moved"),
            "touched": (("data",), touched, "1", "part of held-out transitions that end in contact"),
            "way": (("seed", "iteration", "parameter"), search_means, "1", "mean of the cloud over the truth"),
            "flight": (("parameter",), flight, "1", "upper end at the truth, over it, where nothing touches"),
            "psi": (dimensions, psi_values["psi"], "1", "found over the truth"),
            "low": (dimensions, psi_values["low"], "1", "interval, lower end over the truth"),
            "high": (dimensions, psi_values["high"], "1", "interval, upper end over the truth"),
        },
        {
            "data": list(DATA),
            "model": list(MODELS),
            "where": list(WHERE),
            "parameter": list(PSI),
            "transitions": (sizes, "1", "transitions to learn from"),
            "iteration": (np.arange(search_means.shape[1]), "1", "of the search"),
        },
    )


LINKS = ("torso", "thigh", "leg", "foot")
"""Links of the hopper with a mass and an inertia to learn."""
PSI = ("friction", "spring", "damping", *(f"mass_{link}" for link in LINKS), *(f"inertia_{link}" for link in LINKS))
"""Parameters to learn."""
DATA = ("exact", "noise", "drag")
"""Kinds of transitions."""
DRAG = 50.0
"""Drag of the torso that the model lacks, as the source's parser sets it [N s/m, N m s/rad]."""
POOL = 1
"""Random stream of transitions to learn from."""
HELD = 2
"""Random stream of held-out transitions."""
JUDGES = 1000
"""Largest number of transitions that intervals are computed from."""


@dataclass(frozen=True, eq=False)
class TransitionData:
    """Transitions of one kind: ``pool`` to learn from in random order, ``held`` to judge by.

    ``held`` is always exact; ``touched`` (n,) says where bodies touch in its next states, and
    ``landed`` in those of the pool.
    """

    task: Task
    pool: Buffer
    landed: np.ndarray
    held: Buffer
    touched: np.ndarray

    @classmethod
    def of(cls, kind: str, params: Params, n: int) -> TransitionData:
        """Draw ``n`` transitions of ``kind``, and held-out ones."""
        task = get("hopper")
        explorer = Explorer(task, values={"base_damping": DRAG} if kind == "drag" else None)
        transitions, landed = random_transitions(explorer, n, [params.seed, POOL])
        held, touched = random_transitions(explorer, params.held, [params.seed, HELD])
        rng = np.random.default_rng([params.seed, POOL, 0])
        order = rng.permutation(len(transitions))
        transitions = transitions[order]
        if kind == "noise":
            width = params.noise * OneStepLoss.increments(transitions)
            transitions = replace(
                transitions, x_next=transitions.x_next + width * rng.standard_normal(transitions.x.shape)
            )
        return cls(task, transitions, landed[order], held, touched)

    def errors(self, x_next: np.ndarray) -> np.ndarray:
        """Return mean distances [m, rad, m/s, rad/s] to held-out next states: all, in flight, in contact.

        Steps without a prediction are left out.
        """
        distances = np.linalg.norm(x_next - self.held.x_next, axis=1)
        row_sets = np.ones(len(distances), bool), ~self.touched, self.touched
        return np.array([np.nanmean(distances[rows]) for rows in row_sets])

    @property
    def still(self) -> np.ndarray:
        """Errors of the prediction that nothing moves."""
        return self.errors(self.held.x)

    @cached_property
    def truth(self) -> np.ndarray:
        """True values of psi, the parameters of the hopper."""
        return np.array([self.task.parameters.defaults[name] for name in PSI])


def by_psi(source: TransitionData, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Learn psi from the first ``n`` transitions; return errors, values, intervals and the search's means."""
    transitions = source.pool[:n]
    step = Exact().close(source.task.system)
    loss = OneStepLoss(step, PSI, scale=OneStepLoss.increments(transitions))
    log_offset = np.random.default_rng([params.seed, seed]).uniform(-1.0, 1.0, len(PSI))
    start = loss.start() + np.log(params.spread) * log_offset
    search = RandomSearch(candidates=params.candidates, iterations=params.iterations)
    identified = identify(loss, transitions, start, search, params.seed + seed, params.rows)
    log_psi = np.log(identified.values)
    ends = intervals(loss, log_psi, transitions[:JUDGES], seed=params.seed)
    predicted = loss.errors(log_psi, source.held)[0] * loss.scale + source.held.x_next
    return {
        "errors": source.errors(predicted),
        "psi": identified.values / source.truth,
        "low": ends.low / source.truth,
        "high": ends.high / source.truth,
        "way": identified.model_params / source.truth,
    }


def in_flight(source: TransitionData) -> dict[str, np.ndarray]:
    """Return upper ends of intervals over the truth, from transitions without contact."""
    flying = source.pool[np.flatnonzero(~source.landed)[:JUDGES]]
    scale = OneStepLoss.increments(source.pool)
    loss = OneStepLoss(Exact().close(source.task.system), PSI, scale=scale)
    return {"high": intervals(loss, np.log(source.truth), flying).high / source.truth}


def by_network(source: TransitionData, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Train four layers on the first ``n`` transitions, next state from state and input."""
    transitions, judges, system = source.pool[:n], source.held, source.task.system
    origin = Origin((*system.states, *system.inputs), system.states)
    samples = Samples(np.hstack([transitions.x, transitions.u]), transitions.x_next, origin)
    model = train(
        samples,
        0.0,
        params.seed + seed,
        hidden=(params.units,) * 4,
        epochs=params.epochs,
        batch=256,
        patience=max(1, params.epochs // 6),
    )
    return {"errors": source.errors(model.values(np.hstack([judges.x, judges.u])))}


_PLACE = "Adaptive barrier smoothing, sec. 7, model learning"
"""Source of the claims of the paper."""
_PSI_TOLERANCE = 0.05
"""Relative distance of psi from the truth up to which it is found."""
_COVERED_SHARE = 0.85
"""Share of the intervals of 95 % that must hold the truth: they are few and not independent."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on errors of both models, on psi, and on both where data are not exact."""
    return [*_errors(data), *_found(data), *_noise(data), *_drag(data)]


def _both(data: xr.Dataset, kind: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (transitions, seeds) of psi and of networks, where both have learned."""
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
        claim("A complementarity model approximates contact better than a network", _PLACE)
        .expected("into contact, held out: the largest error over starts below the least of networks")
        .measured(f"{settings_text(learned_sizes, is_better)} transitions; by factors of {format_values(ratio, '.3g')}")
        .holds(is_better),
        claim("So it does over all transitions", _PLACE)
        .expected("likewise")
        .measured(
            f"{format_values(np.median(psi_all, axis=1), '.2g')}"
            f" against {format_values(np.median(network_all, axis=1), '.2g')}"
        )
        .below(psi_all.max(axis=1), network_all.min(axis=1)),
        claim("psi of few transitions is ahead of a network of many", "our check")
        .expected(f"{sizes[1]} transitions against {sizes[-1]}")
        .measured(f"{largest_value(psi_all[1:2]):.2g} against {all_nets[-1].min():.2g}")
        .below(psi_all[1:2], all_nets[-1].min()),
        claim("A network learns from more transitions", "our check")
        .expected(f"the median error from {sizes[-1]} is half of that from {sizes[0]} or less")
        .measured(format_values(falls, ".2g"))
        .at_most(falls[-1], 0.5 * falls[0]),
    ]


def _full(data: xr.Dataset, name: str, kind: str) -> np.ndarray:
    """Return values of psi at the full number of transitions, (seeds, parameters)."""
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
        claim("A drag that the model lacks takes its lead over a network", "our check")
        .expected("less than a tenth of it is left, the network's error over psi's")
        .measured(f"{lead[0]:.2g} of {lead[1]:.2g}")
        .below(lead[0], 0.1 * lead[1]),
        claim("There the intervals hold the truth", "our check")
        .expected(f"{_COVERED_SHARE:.0%} of those of 95 % or more")
        .measured(f"{int(holds_truth.sum())} of {holds_truth.size}; off by {format_values(errors, '.2g')}")
        .holds(holds_truth.mean() >= _COVERED_SHARE, margin=share_margin(holds_truth, _COVERED_SHARE)),
    ]
