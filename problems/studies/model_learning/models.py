"""The two models of AM and what each is given: transitions of a hopper, exact or not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dynamics.contact import Exact
from dynamics.learned.origin import Origin
from dynamics.learned.samples import Samples
from dynamics.learned.training import train
from ocp.learning.buffer import Buffer
from ocp.learning.exploring import Explorer, random_transitions
from ocp.learning.identification import OneStepLoss, RandomSearch, identify, intervals
from ocp.task import Task
from problems.tasks.registry import get

if TYPE_CHECKING:
    from problems.studies.model_learning.data import Params

LINKS = ("torso", "thigh", "leg", "foot")
PSI = ("friction", "spring", "damping", *(f"mass_{link}" for link in LINKS),
       *(f"inertia_{link}" for link in LINKS))  # fmt: skip
DATA = ("exact", "noise", "drag")
DRAG = 50.0
"""Of the torso, as the source's parser sets it [N s/m, N m s/rad]."""
POOL, HELD = 1, 2
"""Streams of transitions: to learn from, to judge by."""
JUDGES = 1000
"""Transitions, at most, that intervals are computed from."""


@dataclass(frozen=True, eq=False)
class Source:
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
    def of(cls, kind: str, params: Params, most: int) -> Source:
        """``most`` transitions of ``kind``, and those to judge by."""
        task = get("hopper")
        explorer = Explorer(task, values={"base_damping": DRAG} if kind == "drag" else None)
        seen, landed = random_transitions(explorer, most, [params.seed, POOL])
        held, touched = random_transitions(explorer, params.held, [params.seed, HELD])
        rng = np.random.default_rng([params.seed, POOL, 0])
        order = rng.permutation(len(seen))
        seen = seen[order]
        if kind == "noise":
            width = params.noise * OneStepLoss.increments(seen)
            seen = replace(seen, x_next=seen.x_next + width * rng.standard_normal(seen.x.shape))
        return cls(task, seen, landed[order], held, touched)

    def errors(self, x_next: np.ndarray) -> np.ndarray:
        """Mean distance [m, rad, m/s, rad/s] to the held-out next states: all, flying, touching.

        Steps without a prediction are left out.
        """
        off = np.linalg.norm(x_next - self.held.x_next, axis=1)
        among = np.ones(len(off), bool), ~self.touched, self.touched
        return np.array([np.nanmean(off[rows]) for rows in among])

    @property
    def still(self) -> np.ndarray:
        """Errors of who says that nothing moves."""
        return self.errors(self.held.x)

    @cached_property
    def truth(self) -> np.ndarray:
        """psi of the hopper."""
        return np.array([self.task.parameters.defaults[name] for name in PSI])


def by_psi(source: Source, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Learn psi from the first ``n`` transitions; errors, values, intervals, and the way there."""
    seen = source.pool[:n]
    step = Exact().close(source.task.system)
    loss = OneStepLoss(step, PSI, scale=OneStepLoss.increments(seen))
    off = np.random.default_rng([params.seed, seed]).uniform(-1.0, 1.0, len(PSI))
    start = loss.start() + np.log(params.spread) * off
    search = RandomSearch(candidates=params.candidates, iterations=params.iterations)
    found = identify(loss, seen, start, search, params.seed + seed, params.rows)
    log_psi = np.log(found.values)
    around = intervals(loss, log_psi, seen[:JUDGES], seed=params.seed)
    predicted = loss.errors(log_psi, source.held)[0] * loss.scale + source.held.x_next
    return {
        "errors": source.errors(predicted), "psi": found.values / source.truth,
        "low": around.low / source.truth, "high": around.high / source.truth,
        "way": found.psi / source.truth,
    }  # fmt: skip


def in_flight(source: Source) -> dict[str, np.ndarray]:
    """Upper ends over the truth of intervals there, of transitions in which nothing touches."""
    flying = source.pool[np.flatnonzero(~source.landed)[:JUDGES]]
    scale = OneStepLoss.increments(source.pool)
    loss = OneStepLoss(Exact().close(source.task.system), PSI, scale=scale)
    return {"high": intervals(loss, np.log(source.truth), flying).high / source.truth}


def by_network(source: Source, n: int, seed: int, params: Params) -> dict[str, np.ndarray]:
    """Train four layers on the first ``n`` transitions, next state from state and input."""
    seen, held, system = source.pool[:n], source.held, source.task.system
    origin = Origin((*system.states, *system.inputs), system.states)
    samples = Samples(np.hstack([seen.x, seen.u]), seen.x_next, origin)
    model = train(samples, 0.0, params.seed + seed, hidden=(params.units,) * 4,
                  epochs=params.epochs, batch=256, patience=max(1, params.epochs // 6))  # fmt: skip
    return {"errors": source.errors(model.values(np.hstack([held.x, held.u])))}
