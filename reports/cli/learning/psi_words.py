"""From ``-s psi=...`` to physical parameters that are learned beside the policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_type_hints

from ocp.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from ocp.learning.protocol import Algorithm

WORD = "psi"
SETTINGS = {
    "psi": "parameters of the task that are learned too, names with commas",
    "psi.NAME": "what such a parameter of the model is at first",
    "psi.walkers": "episodes that go on in every iteration; psi.steps of each",
}
"""What ``-s`` takes of it; the rest are fields of PsiLearning and of its random search."""


@dataclass(frozen=True)
class Believed:
    """``names`` are learned, ``guesses`` are values of the model's at first, by name."""

    names: tuple[str, ...] = ()
    guesses: dict[str, float] = field(default_factory=dict)
    own: dict[str, Any] = field(default_factory=dict)
    search: dict[str, Any] = field(default_factory=dict)

    def beside(self, algorithm: Algorithm) -> Algorithm:
        """The algorithm, on a model whose parameters are learned where that is asked for."""
        from ocp.learning.identification import RandomSearch
        from ocp.learning.identification.psi_learning import PsiLearning

        if not self.names:
            return algorithm
        search = RandomSearch(**self.search)
        return PsiLearning(algorithm=algorithm, names=self.names, search=search, **self.own)


def believed(given: Mapping[str, str], physical: Sequence[str]) -> Believed:
    """Read the settings among ``given`` that begin with psi; ``physical`` are the task's.

    Raises :class:`~ocp.errors.InputError` for unknown names and values that cannot be.
    """
    from ocp.learning.identification import RandomSearch
    from ocp.learning.identification.psi_learning import PsiLearning
    from ocp.words.typed import read

    kinds = [get_type_hints(PsiLearning), get_type_hints(RandomSearch)]
    own, search = (
        {f.name: kind[f.name] for f in fields(cls) if kind[f.name] in (int, float)}
        for cls, kind in zip((PsiLearning, RandomSearch), kinds, strict=True)
    )
    known = [*physical, *own, *search]
    found = Believed(_names(given.get(WORD, ""), physical))
    for key, text in given.items():
        name = key.removeprefix(f"{WORD}.")
        if not is_psi(key) or key == WORD:
            continue
        if name not in known:
            raise InputError(
                f"no setting {key!r}{did_you_mean(name, known)}; psi takes {', '.join(known)}"
            )
        kind, values = (own.get(name), found.own) if name in own else (
            (search.get(name), found.search) if name in search else (float, found.guesses)
        )  # fmt: skip
        values[name] = read(f"setting {key}", text, kind)
    if not found.names and (found.own or found.search):
        raise InputError(
            f"setting {WORD}.{next(iter({**found.own, **found.search}))} is of learning physical"
            f" parameters, and none is named; say -s {WORD}={physical[0]}"
        )
    return found


def is_psi(key: str) -> bool:
    """Whether a setting is one of these."""
    return key.partition(".")[0] == WORD


def _names(text: str, physical: Sequence[str]) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in physical:
            raise InputError(
                f"setting {WORD}: the task has no parameter {name!r}"
                f"{did_you_mean(name, physical)}; there are {', '.join(physical)}"
            )
    if len(set(names)) < len(names):
        raise InputError(f"setting {WORD}: {text} names one twice; name each once")
    return names
