"""Physical parameters psi of a model from transitions of the system that it is of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ocp.errors import InputError
from ocp.learning.buffer import Buffer
from ocp.learning.identification.one_step import OneStepLoss
from ocp.learning.identification.random_search import Cloud, RandomSearch

DRAWS, ROWS = 1, 2
"""Streams of random numbers: of candidates, of the transitions that judge them."""

Report = Callable[[int, float], None]


@dataclass(frozen=True, eq=False)
class Identification:
    """psi as found, ``values`` (n,) in the order of ``names``, and how the search came there.

    ``loss`` is eq. 4.1's over all transitions, over their number; ``model_params`` (k, n) are the
    means of the cloud, first its start, and ``spread`` (k, n) its standard deviations of log psi; a pass
    begins where the last one ended.
    """

    names: tuple[str, ...]
    values: np.ndarray
    loss: float
    start_loss: float
    model_params: np.ndarray = field(repr=False)
    spread: np.ndarray = field(repr=False)

    @property
    def by_name(self) -> dict[str, float]:
        """The found values by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


def search_iteration(
    loss: OneStepLoss, buffer: Buffer, search: RandomSearch, cloud: Cloud, seed: list[int],
    rows: int,
) -> Cloud:  # fmt: skip
    """One iteration of the search: candidates, judged alike by ``rows`` transitions drawn anew.

    Random numbers depend on the seed and the number of the iteration alone.
    """
    count = int(cloud["count"])
    judges = buffer
    if rows < len(buffer):
        drawn = np.random.default_rng([*seed, count, ROWS]).choice(len(buffer), rows, replace=False)
        judges = buffer[np.sort(drawn)]
    rng = np.random.default_rng([*seed, count, DRAWS])
    return search.iterate(cloud, lambda candidates: loss(candidates, judges), rng)


def identify(
    loss: OneStepLoss,
    buffer: Buffer,
    start: np.ndarray,
    search: RandomSearch | None = None,
    seed: int = 0,
    rows: int = 128,
    report: Report | None = None,
) -> Identification:
    """Minimise ``loss`` over log psi from ``start`` (n_psi,) by random search [abs eq. 4.1].

    Every iteration is judged by ``rows`` transitions; all of them choose between the start and the
    last means of the passes, and tell how sensitive the model is. ``report`` is told the number of
    iterations and the largest standard deviation of the cloud.

    Raises :class:`~ocp.errors.InputError` without transitions and for ``rows`` below 1.
    """
    if not len(buffer) or rows < 1:
        raise InputError(f"psi is learned from transitions: got {len(buffer)}, {rows} at a time")
    search = search or RandomSearch()
    clouds, ends = [search.begin(start)], [np.asarray(start, dtype=float)]
    for number in range(search.passes):
        if number:
            moves = loss.sensitivity(ends[-1], search.width, buffer)
            clouds.append(search.begin(ends[-1], moves, start))
        while not search.done(clouds[-1]):
            clouds.append(search_iteration(loss, buffer, search, clouds[-1], [seed, number], rows))
            if report:
                report(len(clouds) - 1, float(np.max(search.deviations(clouds[-1]))))
        ends.append(clouds[-1]["mean"])
    losses = loss(np.array(ends), buffer) / len(buffer)
    return Identification(
        names=loss.names,
        values=np.exp(ends[int(np.argmin(losses))]),
        loss=float(losses.min()),
        start_loss=float(losses[0]),
        model_params=np.exp([each["mean"] for each in clouds]),
        spread=np.array([search.deviations(each) for each in clouds]),
    )
