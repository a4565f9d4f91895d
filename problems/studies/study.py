"""Studies of papers' figures: parameters, a run that returns data with units, and claims checked against the data."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic.fields import FieldInfo

from dynamics.settings import Range, declare
from ocp.errors import InputError
from ocp.store.checkpoint import UNSAVED, SavedWork
from problems.parameters import Parameters
from problems.spec import Citation, check_parameters

if TYPE_CHECKING:
    import xarray as xr

WITHIN_NOISE = "within noise"
"""Verdict on a claim whose statistic is too near to its threshold for a decision."""
_NOISE_MARGIN = 3.0
"""Distance of a statistic from its threshold, in standard errors, below which a claim is within noise."""
PAPER = "paper"
"""Origin of a value in the text of the paper."""
CODE = "authors' code"
"""Origin of a value from the authors' public code."""
CHOICE = "our choice"
"""Origin of a value without a source."""


def setting(default: float, unit: str, meaning: str, origin: str = CHOICE, **limits: Unpack[Range]) -> Any:
    """Declare a study's parameter in SI ``unit``, with its range ``limits`` and the ``origin`` of its default."""
    return declare(default, meaning, unit, limits, origin=origin)


def origin_of(field: FieldInfo) -> str:
    """Return the origin of a parameter's default: :data:`PAPER`, :data:`CODE` or :data:`CHOICE`."""
    extra = field.json_schema_extra
    return str(extra.get("origin", CHOICE)) if isinstance(extra, dict) else CHOICE


class StudyParams(Parameters):
    """Base class of every study's parameters; a study without noise does not use the seed."""

    seed: int = setting(0, "1", "seed of everything random", least=0, most=2**31 - 1)


class FinishedParts:
    """Results of a study's finished parts, each under a key, stored in a checkpoint if there is one.

    Independent parts are computed in ``jobs`` processes, by default one per CPU, or on the cluster
    of ``scheduler``.
    """

    def __init__(self, checkpoint: SavedWork = UNSAVED, jobs: int | None = None, scheduler: str | None = None) -> None:
        self._checkpoint, self.scheduler = checkpoint, scheduler
        self.jobs = len(os.sched_getaffinity(0)) if jobs is None else jobs

    def get(self, key: str, compute: Callable[[], Mapping[str, ArrayLike]]) -> dict[str, np.ndarray]:
        """Return the arrays of the part ``key``; compute and store them first if it is not finished."""
        arrays = self.load(key)
        return self.save(key, compute()) if arrays is None else arrays

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """Return the stored arrays of the part ``key``, or None if it is not finished."""
        return self._checkpoint.state(key)

    def save(self, key: str, computed: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
        """Store the arrays ``computed`` for the part ``key``, and return them as NumPy arrays."""
        arrays = {name: np.asarray(array) for name, array in computed.items()}
        self._checkpoint.save_state(key, **arrays)
        return arrays


@dataclass(frozen=True)
class Claim:
    """Sentence from a paper, what was expected and measured, and whether it holds.

    ``source`` is the paper and the section, equation or figure; ``expected`` and ``measured`` are short texts with
    units; ``holds`` says whether the sentence is true as written. If this depends on a statistic of samples,
    ``margin`` is its distance from the threshold in standard errors; otherwise it is None.
    """

    claim: str
    source: str
    expected: str
    measured: str
    holds: bool
    margin: float | None = None


@dataclass(frozen=True)
class Statement:
    """Sentence to be checked against data: :meth:`holds` and the comparisons turn it into a :class:`Claim`.

    A comparison must hold for every entry of its array. It fails for an empty array and for NaN.
    """

    sentence: str
    source: str
    expectation: str = ""
    observation: str = ""

    def expected(self, text: str) -> Statement:
        """Return a copy of the statement whose expected value, according to the source, is ``text``."""
        return replace(self, expectation=text)

    def measured(self, text: str) -> Statement:
        """Return a copy of the statement whose measured value, with units, is ``text``."""
        return replace(self, observation=text)

    def holds(self, *conditions: ArrayLike, margin: float | None = None) -> Claim:
        """Return the claim, which holds if all truth values are true; see :class:`Claim` for ``margin``."""
        marks = [np.asarray(condition, dtype=bool) for condition in conditions]
        holds = all(mark.size > 0 and bool(mark.all()) for mark in marks)
        return Claim(self.sentence, self.source, self.expectation, self.observation, holds, margin)

    def below(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Return the claim, which holds if ``values < limit``."""
        return self.holds(np.less(values, limit))

    def at_most(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Return the claim, which holds if ``values <= limit``."""
        return self.holds(np.less_equal(values, limit))

    def above(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Return the claim, which holds if ``values > limit``."""
        return self.holds(np.greater(values, limit))

    def at_least(self, values: ArrayLike, limit: ArrayLike) -> Claim:
        """Return the claim, which holds if ``values >= limit``."""
        return self.holds(np.greater_equal(values, limit))

    def between(self, values: ArrayLike, low: ArrayLike, high: ArrayLike) -> Claim:
        """Return the claim, which holds if ``low < values < high``."""
        return self.holds(np.greater(values, low), np.less(values, high))

    def equals(self, values: ArrayLike, target: ArrayLike, within: float = 0.0) -> Claim:
        """Return the claim, which holds if ``|values - target| < within``, or if both are equal for ``within = 0``."""
        if within == 0:
            return self.holds(np.equal(values, target))
        return self.below(np.abs(np.subtract(values, target)), within)


def claim(sentence: str, source: str) -> Statement:
    """Return a statement from ``source`` (the paper, with section or figure), from which to build a claim.

    A claim is built by ``claim(sentence, source).expected(words).measured(words).below(values,
    limit)``, or with another condition of :class:`Statement` at the end.
    """
    return Statement(sentence, source)


@dataclass(frozen=True)
class FigureStudy:
    """Study of one figure: its run, its claims and its source.

    ``module`` in ``problems.studies`` is imported on first use, because that is slow and a list of
    studies does not need it. It defines ``Params``; ``run(params)``, which returns a dataset with
    ``units`` on every numeric variable and coordinate (:func:`dataset`); ``claims(data)``, which
    checks that dataset, with the parameters as attributes; and ``NOTES``, sentences on choices and
    corrections. A long study sets ``RESUMES``: its ``run(params, finished)`` loads finished parts.
    ``QUICK`` maps parameters to values for a run of at most 20 s, too small to support the claims.
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
        """Pydantic model of the study's parameters."""
        return self._module.Params

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on choices and corrections that a reader of the figure must know."""
        return self._module.NOTES

    @property
    def resumes(self) -> bool:
        """Whether an interrupted run continues from its finished parts."""
        return getattr(self._module, "RESUMES", False)

    @property
    def quick(self) -> Mapping[str, int]:
        """Mapping from parameter to value for a quick run of at most 20 s; empty if the study needs none."""
        return getattr(self._module, "QUICK", {})

    def claims(self, data: xr.Dataset) -> list[Claim]:
        """Return the claims of the study, checked against its ``data``."""
        return self._module.claims(data)

    def params(self, values: Mapping[str, Any]) -> Any:
        """Return the parameters of a run: the checked ``values``, with defaults for missing parameters.

        Raises :class:`~ocp.errors.InputError` with the parameter, its unit and its range in its message.
        """
        return check_parameters(self.id, self.Params, values)

    def data(
        self,
        values: Mapping[str, Any] | None = None,
        checkpoint: SavedWork = UNSAVED,
        jobs: int | None = None,
        scheduler: str | None = None,
    ) -> xr.Dataset:
        """Run the study at ``values`` (defaults for others); return its data, with the parameters as attributes.

        A study that resumes loads finished parts from ``checkpoint`` and stores new parts there; for
        ``jobs`` and ``scheduler`` see :class:`FinishedParts`.

        Raises :class:`~ocp.errors.InputError` for a bad parameter and ``ValueError`` if a variable has no units.
        """
        params = self.params(values or {})
        finished = [FinishedParts(checkpoint, jobs, scheduler)] if self.resumes else []
        data = self._module.run(params, *finished)
        for name, array in data.variables.items():
            if array.dtype.kind in "fiu" and "units" not in array.attrs:
                raise ValueError(f"study {self.id}: {name} has no units")
        return data.assign_attrs({"study": self.id, **params.model_dump()})


def dataset(variables: Mapping[str, Any], coordinates: Mapping[str, Any]) -> xr.Dataset:
    """Build a dataset whose arrays have the attributes ``units`` and ``long_name``.

    A variable is (dims, values, unit, meaning), or (dims, values) for strings; a coordinate is
    (values, unit, meaning) or (values, unit), or a list of strings.
    """

    def labelled(dims: Any, values: ArrayLike, *unit_and_meaning: str) -> Any:
        names = ("units", "long_name")
        return dims, np.asarray(values), dict(zip(names, unit_and_meaning, strict=False))

    import xarray as xr

    return xr.Dataset(
        {name: labelled(*of) if len(of) == 4 else of for name, of in variables.items()},
        {name: labelled(name, *of) if isinstance(of, tuple) else of for name, of in coordinates.items()},
    )


def share_margin(marks: ArrayLike, least: float) -> float:
    """Return the difference between the fraction of true ``marks`` and ``least``, in binomial standard errors."""
    truths = np.asarray(marks, dtype=float)
    return float((truths.sum() - least * truths.size) / np.sqrt(least * (1 - least) * truths.size))


def largest_value(values: ArrayLike) -> float:
    """Return the largest of ``values``, or NaN if there are none, for which every comparison fails."""
    return float(np.max(values)) if np.size(values) else float("nan")


def format_values(values: Iterable[float], form: str) -> str:
    """Return ``values`` in the format ``form``, separated by commas: ``0.10, 0.25``."""
    return ", ".join(format(value, form) for value in values)


def settings_text(settings: Sequence[object], marks: ArrayLike) -> str:
    """Return a text on the ``settings`` for which a claim holds: ``for all of a, b`` or ``for a, not for b``.

    Numbers are written with four digits; ``marks`` has one truth value for each setting.
    """
    text = [f"{s:.4g}" if isinstance(s, int | float) else str(s) for s in settings]
    truths = np.asarray(marks, dtype=bool)
    true_at, false_at = (
        ", ".join(word for word, mark in zip(text, truths, strict=True) if mark is np.bool_(kind))
        for kind in (True, False)
    )
    if not false_at:
        return f"for all of {true_at}"
    return f"for {true_at}, not for {false_at}" if true_at else f"for none of {false_at}"


def claim_verdict(holds: bool, margin: float | None = None) -> str:
    """Return the verdict on a claim: ``holds``, ``does not hold`` or, for a ``margin`` below 3, ``within noise``.

    Other seeds, or other rounding errors, may reverse a claim that is within noise.
    """
    if margin is not None and abs(margin) < _NOISE_MARGIN:
        return WITHIN_NOISE
    return "holds" if holds else "does not hold"


def count_text(claims: Iterable[Claim | Mapping[str, Any]]) -> str:
    """Return a text on the numbers of claims that hold and that are within noise: ``5 of 7 (1 within noise)``.

    Claims may also be mappings, as stored in the record of a run.
    """
    rows = [claim if isinstance(claim, Mapping) else vars(claim) for claim in claims]
    verdicts = [claim_verdict(row["holds"], row.get("margin")) for row in rows]
    n_noise = verdicts.count(WITHIN_NOISE)
    return f"{verdicts.count('holds')} of {len(verdicts)}" + f" ({n_noise} within noise)" * bool(n_noise)


def claims_sentence(claims: Sequence[Claim]) -> str:
    """Return a sentence with the number of claims that hold; raise ``InputError`` if there are no claims."""
    if not claims:
        raise InputError("a study without claims checks nothing; give it at least one")
    return f"{count_text(claims)} claims hold."
