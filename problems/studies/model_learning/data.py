"""AM: one-step errors of a hopper with learned parameters psi, and of a network, over the number of transitions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import xarray as xr

from dynamics.contact import Exact
from dynamics.learned.training import train_network
from dynamics.learned.transitions import DataOrigin, Samples
from ocp.learning.explorer import Buffer, Explorer, random_transitions
from ocp.learning.identify import OneStepLoss, bootstrap_intervals, identify
from ocp.problem.task import Task
from ocp.search.random_search import RandomSearch
from problems.studies.progress import track_items
from problems.studies.study import FinishedParts, StudyParams, dataset, setting
from problems.tasks.registry import get

QUICK = {"seeds": 1, "held": 100, "iterations": 20, "rows": 32, "units": 32, "epochs": 20}
RESUMES = True


WHERE = ("all", "flight", "contact")
"""Names of the groups of held-out transitions over which errors are averaged."""
MODELS = ("psi", "network")
"""Names of the models that are compared."""
MIXED = "m, rad, m/s, rad/s"
"""Units of one-step errors, which add coordinates of different units as the paper does."""


class Params(StudyParams):
    """Parameters of study AM; the network's parameters are from the authors' code, the others are our choice."""

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
    """Return the numbers of training transitions; only networks use the last, four times the full number."""
    return [params.data // 40, params.data // 10, params.data // 4, params.data, 4 * params.data]


def run(params: Params, finished: FinishedParts) -> xr.Dataset:
    """Fit models to each number of exact transitions, and to ``params.data`` transitions with noise or drag."""
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
            flight = finished.get("flight", partial(in_flight, source))["high"]
        for j, n in enumerate(sizes):
            if kind != DATA[0] and n != params.data:
                continue
            for seed in track_items(f"{kind}, {n} transitions: seeds", range(params.seeds)):
                key = f"{kind}-{n}-{seed}"
                make = partial(by_network, source, n, seed, params)
                errors[i, 1, j, seed] = finished.get(f"network-{key}", make)["errors"]
                if n > params.data:
                    continue
                piece = finished.get(f"psi-{key}", partial(by_psi, source, n, seed, params))
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
"""Links of the hopper whose mass and inertia are learned."""
PSI = ("friction", "spring", "damping", *(f"mass_{link}" for link in LINKS), *(f"inertia_{link}" for link in LINKS))
"""Names of the hopper's parameters that are learned."""
DATA = ("exact", "noise", "drag")
"""Kinds of transitions: exact, with noise on next states, and with a drag that the learned model lacks."""
DRAG = 50.0
"""Drag on the torso [N s/m, N m s/rad] that the learned model lacks; its value is from the authors' code."""
POOL = 1
"""Seed key of the random stream of training transitions."""
HELD = 2
"""Seed key of the random stream of held-out transitions."""
JUDGES = 1000
"""Maximum number of transitions from which bootstrap intervals are computed."""


@dataclass(frozen=True, eq=False)
class TransitionData:
    """Transitions of one kind: ``pool`` for training, in random order, and ``held``, held out for tests.

    ``held`` has no noise. The masks ``landed`` (n,) for ``pool`` and ``touched`` (n,) for ``held`` are
    True where bodies touch in the next state.
    """

    task: Task
    pool: Buffer
    landed: np.ndarray
    held: Buffer
    touched: np.ndarray

    @classmethod
    def of(cls, kind: str, params: Params, n: int) -> TransitionData:
        """Draw ``n`` transitions of ``kind``, one of :data:`DATA`, and further transitions that are held out."""
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
        """Return mean errors (3,) of the predicted next states ``x_next``: of all, in flight, and in contact.

        Units are :data:`MIXED`. NaN predictions are left out.
        """
        distances = np.linalg.norm(x_next - self.held.x_next, axis=1)
        row_sets = np.ones(len(distances), bool), ~self.touched, self.touched
        return np.array([np.nanmean(distances[rows]) for rows in row_sets])

    @property
    def still(self) -> np.ndarray:
        """Mean errors (3,) of the prediction that the state does not change; see :meth:`errors`."""
        return self.errors(self.held.x)

    @cached_property
    def truth(self) -> np.ndarray:
        """True values of psi, the hopper's parameters."""
        return np.array([self.task.parameters.defaults[name] for name in PSI])


def by_psi(source: TransitionData, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Learn psi from the first ``n`` transitions, and return a mapping from names to arrays.

    ``errors`` are held-out errors. Three arrays are divided by the true values: ``psi``, the ends ``low`` and
    ``high`` of its intervals, and ``way``, the values of psi during the search.
    """
    transitions = source.pool[:n]
    step = Exact().close(source.task.system)
    loss = OneStepLoss(step, PSI, scale=OneStepLoss.increments(transitions))
    log_offset = np.random.default_rng([params.seed, seed]).uniform(-1.0, 1.0, len(PSI))
    start = loss.start() + np.log(params.spread) * log_offset
    search = RandomSearch(candidates=params.candidates, iterations=params.iterations)
    identified = identify(loss, transitions, start, search, params.seed + seed, params.rows)
    log_psi = np.log(identified.values)
    ends = bootstrap_intervals(loss, log_psi, transitions[:JUDGES], seed=params.seed)
    predicted = loss.errors(log_psi, source.held)[0] * loss.scale + source.held.x_next
    return {
        "errors": source.errors(predicted),
        "psi": identified.values / source.truth,
        "low": ends.low / source.truth,
        "high": ends.high / source.truth,
        "way": identified.model_params / source.truth,
    }


def in_flight(source: TransitionData) -> dict[str, np.ndarray]:
    """Return the upper ends of psi's intervals from transitions without contact, relative to the true values."""
    flying = source.pool[np.flatnonzero(~source.landed)[:JUDGES]]
    scale = OneStepLoss.increments(source.pool)
    loss = OneStepLoss(Exact().close(source.task.system), PSI, scale=scale)
    return {"high": bootstrap_intervals(loss, np.log(source.truth), flying).high / source.truth}


def by_network(source: TransitionData, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Train a network of four layers on the first ``n`` transitions, and return its held-out errors."""
    transitions, judges, system = source.pool[:n], source.held, source.task.system
    origin = DataOrigin((*system.states, *system.inputs), system.states)
    samples = Samples(np.hstack([transitions.x, transitions.u]), transitions.x_next, origin)
    model = train_network(
        samples,
        0.0,
        params.seed + seed,
        hidden=(params.units,) * 4,
        epochs=params.epochs,
        batch=256,
        patience=max(1, params.epochs // 6),
    )
    return {"errors": source.errors(model.values(np.hstack([judges.x, judges.u])))}
