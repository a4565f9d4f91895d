"""Study of a paper's figure: parameters, a run that gives data with units, claims to check."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pydantic.fields import FieldInfo

from dynamics.settings import Range, declare
from ocp.errors import InputError
from ocp.store.checkpoint import UNSAVED, SavedWork
from problems.parameters import Parameters
from problems.spec import Citation, check_parameters

WITHIN_NOISE = "within noise"
"""Verdict of a claim whose margin is small."""
_NOISE_MARGIN = 3.0
"""Margin below which a claim is within noise, in standard errors."""
PAPER = "paper"
"""Origin of a value that the paper's text states."""
CODE = "authors' code"
"""Origin of a value that the authors' public code has."""
CHOICE = "our choice"
"""Origin of a value that no source states."""


def setting(default: float, unit: str, meaning: str, origin: str = CHOICE, **limits: Unpack[Range]) -> Any:
    """Declare a study's parameter in SI ``unit``, with its range and its :data:`origin <PAPER>`."""
    return declare(default, meaning, unit, limits, origin=origin)


def origin_of(field: FieldInfo) -> str:
    """Return where the value of a study's parameter comes from."""
    extra = field.json_schema_extra
    return str(extra.get("origin", CHOICE)) if isinstance(extra, dict) else CHOICE


class StudyParams(Parameters):
    """Base of every study's parameters; a study without noise leaves the seed unused."""

    seed: int = setting(0, "1", "seed of everything random", least=0, most=2**31 - 1)


class FinishedParts:
    """Finished parts of a study by their keys, stored in a checkpoint where there is one.

    Parts that are independent jobs go to ``jobs`` processes, by default one a CPU, or to the
    cluster of ``scheduler``.
    """

    def __init__(self, checkpoint: SavedWork = UNSAVED, jobs: int | None = None, scheduler: str | None = None) -> None:
        self._checkpoint, self.scheduler = checkpoint, scheduler
        self.jobs = len(os.sched_getaffinity(0)) if jobs is None else jobs

    def get(self, key: str, compute: Callable[[], Mapping[str, ArrayLike]]) -> dict[str, np.ndarray]:
        """Return the arrays of a part; compute and store them where they are not stored."""
        arrays = self.load(key)
        return self.save(key, compute()) if arrays is None else arrays

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """Return the stored arrays of a part, or None where it is not finished."""
        return self._checkpoint.state(key)

    def save(self, key: str, computed: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
        """Store the arrays of a part, and return them."""
        arrays = {name: np.asarray(array) for name, array in computed.items()}
        self._checkpoint.save_state(key, **arrays)
        return arrays


@dataclass(frozen=True)
class Claim:
    """Sentence of a paper, and its measured verdict.

    ``source`` is the paper and the place in it; ``expected`` and ``measured`` are short texts with
    units, ``holds`` whether the sentence is true as it stands. Where a statistic of samples decides
    that, ``margin`` is how far it lies from its threshold, in its standard errors; None elsewhere.
    """

    claim: str
    source: str
    expected: str
    measured: str
    holds: bool
    margin: float | None = None


@dataclass(frozen=True)
class Statement:
    """A sentence to be checked against data: :meth:`holds` and the comparisons turn it into a :class:`Claim`.

    A condition must hold for every entry of its array. None holds for an empty array or for NaN.
    """

    sentence: str
    source: str
    expectation: str = ""
    observation: str = ""

    def expected(self, words: str) -> Statement:
        """Add what the source says, with units."""
        return replace(self, expectation=words)

    def measured(self, words: str) -> Statement:
        """Add what the data say, with units."""
        return replace(self, observation=words)

    def holds(self, *conditions: ArrayLike, margin: float | None = None) -> Claim:
        """Decide by truth values, all of which must be true; see :class:`Claim` for ``margin``."""
        marks = [np.asarray(condition, dtype=bool) for condition in conditions]
        holds = all(mark.size > 0 and bool(mark.all()) for mark in marks)
        return Claim(self.sentence, self.source, self.expectation, self.observation, holds, margin)

    def below(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Require ``values < limit``."""
        return self.holds(np.less(values, limit))

    def at_most(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Require ``values <= limit``."""
        return self.holds(np.less_equal(values, limit))

    def above(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Require ``values > limit``."""
        return self.holds(np.greater(values, limit))

    def at_least(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Require ``values >= limit``."""
        return self.holds(np.greater_equal(values, limit))

    def between(self, values: ArrayLike, low: ArrayLike, high: ArrayLike) -> Claim:
        """Require ``low < values < high``."""
        return self.holds(np.greater(values, low), np.less(values, high))

    def equals(self, values: ArrayLike, target: ArrayLike, within: float = 0.0) -> Claim:
        """Require ``|values - target| < within``, or equality where that is zero."""
        if within == 0:
            return self.holds(np.equal(values, target))
        return self.below(np.abs(np.subtract(values, target)), within)


def claim(sentence: str, source: str) -> Statement:
    """Begin a claim of ``source``, which names the paper and the place in it.

    Every claim is made as ``claim(sentence, source).expected(words).measured(words).below(values,
    limit)``, or with another condition of :class:`Statement` at the end.
    """
    return Statement(sentence, source)


@dataclass(frozen=True)
class FigureStudy:
    """Study of one figure: its run, its claims and its source.

    ``module`` in ``problems.studies`` is loaded on first use, because that is slow and a list of
    studies needs none. It defines ``Params``; ``run(params)``, which returns pure data, where every
    numeric variable and coordinate has ``units`` (:func:`dataset`); ``claims(data)``, which
    reads that data, whose attributes hold the parameters; and ``NOTES``, what a reader must know of
    choices and corrections. A long study sets ``RESUMES``: its ``run(params, finished)`` looks up
    each finished part first. ``QUICK`` are sizes at which it takes at most 20 s, and its claims
    carry little weight.
    """

    id: str
    module: str
    title: str
    citation: Citation

    @property
    def _module(self) -> Any:
        return import_module(self.module)

    @property
    def Params(self) -> type[StudyParams]:
        """The pydantic model of the parameters."""
        return self._module.Params

    @property
    def notes(self) -> tuple[str, ...]:
        """Choices and corrections that a reader must know."""
        return self._module.NOTES

    @property
    def resumes(self) -> bool:
        """Whether an interrupted run continues from its finished parts."""
        return getattr(self._module, "RESUMES", False)

    @property
    def quick(self) -> Mapping[str, int]:
        """Sizes of a quick look."""
        return getattr(self._module, "QUICK", {})

    def claims(self, data: xr.Dataset) -> list[Claim]:
        """Return every sentence of the paper beside what ``data`` show."""
        return self._module.claims(data)

    def params(self, values: Mapping[str, Any]) -> Any:
        """Check ``values`` and fill in the defaults.

        Raises :class:`~ocp.errors.InputError` that names the parameter, its unit and its range.
        """
        return check_parameters(self.id, self.Params, values)

    def data(
        self,
        values: Mapping[str, Any] | None = None,
        checkpoint: SavedWork = UNSAVED,
        jobs: int | None = None,
        scheduler: str | None = None,
    ) -> xr.Dataset:
        """Run at ``values``, the rest at their defaults; the parameters become attributes.

        Parts of a study that resumes are loaded from ``checkpoint`` and stored there, and computed where
        :class:`FinishedParts` states.

        Raises :class:`~ocp.errors.InputError` for a bad parameter and ``ValueError`` where a
        variable has no units.
        """
        params = self.params(values or {})
        finished = [FinishedParts(checkpoint, jobs, scheduler)] if self.resumes else []
        data = self._module.run(params, *finished)
        for name, array in data.variables.items():
            if array.dtype.kind in "fiu" and "units" not in array.attrs:
                raise ValueError(f"study {self.id}: {name} has no units")
        return data.assign_attrs({"study": self.id, **params.model_dump()})


def dataset(variables: Mapping[str, Any], coordinates: Mapping[str, Any]) -> xr.Dataset:
    """Label arrays with ``units`` and ``long_name``.

    A variable is (dims, values, unit, meaning), or (dims, values) of words; a coordinate
    (values, unit, meaning) or (values, unit), or a list of words.
    """

    def labelled(dims: Any, values: ArrayLike, *unit_and_meaning: str) -> Any:
        names = ("units", "long_name")
        return dims, np.asarray(values), dict(zip(names, unit_and_meaning, strict=False))

    return xr.Dataset(
        {name: labelled(*of) if len(of) == 4 else of for name, of in variables.items()},
        {name: labelled(name, *of) if isinstance(of, tuple) else of for name, of in coordinates.items()},
    )


def share_margin(marks: ArrayLike, least: float) -> float:
    """Return the distance of the share of ``marks`` from ``least``, in binomial standard errors at ``least``."""
    truths = np.asarray(marks, dtype=float)
    return float((truths.sum() - least * truths.size) / np.sqrt(least * (1 - least) * truths.size))


def largest_value(values: ArrayLike) -> float:
    """Return the largest of ``values``; NaN, under which no claim holds, where there are none."""
    return float(np.max(values)) if np.size(values) else float("nan")


def format_values(values: Iterable[float], form: str) -> str:
    """Write all of ``values`` in the format ``form``: ``0.10, 0.25``."""
    return ", ".join(format(value, form) for value in values)


def settings_text(settings: Sequence[object], marks: ArrayLike) -> str:
    """Say at which of ``settings`` a sentence held: ``for all``, ``for a, b, not for c``.

    Numbers are shortened to four digits; ``marks`` has one truth value a setting.
    """
    words = [f"{s:.4g}" if isinstance(s, int | float) else str(s) for s in settings]
    truths = np.asarray(marks, dtype=bool)
    true_at, false_at = (
        ", ".join(word for word, mark in zip(words, truths, strict=True) if mark is np.bool_(kind))
        for kind in (True, False)
    )
    if not false_at:
        return f"for all of {true_at}"
    return f"for {true_at}, not for {false_at}" if true_at else f"for none of {false_at}"


def claim_verdict(holds: bool, margin: float | None = None) -> str:
    """Say whether a claim holds, or that its statistic is within 3 standard errors of deciding.

    Other seeds, or another processor's rounding, may change a verdict that is within noise.
    """
    if margin is not None and abs(margin) < _NOISE_MARGIN:
        return WITHIN_NOISE
    return "holds" if holds else "does not hold"


def count_text(claims: Iterable[Claim | Mapping[str, Any]]) -> str:
    """Say how many claims hold, of how many, and how many are within noise.

    Claims may be rows of a run's record.
    """
    rows = [claim if isinstance(claim, Mapping) else vars(claim) for claim in claims]
    verdicts = [claim_verdict(row["holds"], row.get("margin")) for row in rows]
    n_noise = verdicts.count(WITHIN_NOISE)
    return f"{verdicts.count('holds')} of {len(verdicts)}" + f" ({n_noise} within noise)" * bool(n_noise)


def claims_sentence(claims: Sequence[Claim]) -> str:
    """Say in one sentence how many claims hold."""
    if not claims:
        raise InputError("a study without claims checks nothing; give it at least one")
    return f"{count_text(claims)} claims hold."
