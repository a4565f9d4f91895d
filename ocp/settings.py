"""Read ``-s key=value`` settings: a few of our own, the rest the solver's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from ocp.errors import InputError
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES

OWN = {
    "homotopy": "true or false: follow a law's knob down from a wide start (default: true where a"
    " law smooths); exact law in shooting: true follows the barrier law down, false is the gradient"
    " method alone, and the default rolls out the plan of the direct transcription",
    "strategy": "how exact complementarity is met in a direct transcription",
    "factor": "factor by which the homotopy's knob shrinks, between 0 and 1",
    "start": "first value of the homotopy's knob",
    "jit": "true or false: evaluate by compiled C, cached, where a compiler is found",
}


@dataclass(frozen=True)
class Settings:
    """Validated settings; ``options`` go to the solver unread."""

    homotopy: bool | None = None
    strategy: str = DEFAULT_STRATEGY
    factor: float | None = None
    start: float | None = None
    jit: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, raw: dict[str, Any]) -> Settings:
        """Read strings (or values) by key; raises :class:`~ocp.errors.InputError`."""
        own: dict[str, Any] = {}
        options: dict[str, Any] = {}
        for key, value in raw.items():
            if key in ("homotopy", "jit"):
                own[key] = _flag(key, value)
            elif key in ("factor", "start"):
                own[key] = _number(key, value)
            elif key == "strategy":
                own[key] = _strategy(str(value))
            else:
                options[key.removeprefix("ipopt.")] = literal(value)
        if own.get("factor") is not None and not own["factor"] < 1:
            raise InputError(f"setting factor must lie between 0 and 1, got {own['factor']}")
        return cls(**own, options=options)


def _flag(key: str, value: Any) -> bool:
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    word = str(value).lower()
    if word not in words:
        raise InputError(f"setting {key} must be true or false, got {value!r}")
    return words[word]


def _number(key: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise InputError(f"setting {key} must be a positive finite number, got {value!r}")
    return number


def _strategy(name: str) -> str:
    if name not in STRATEGIES:
        raise InputError(f"unknown strategy {name!r}; there are {', '.join(STRATEGIES)}")
    return name


def literal(value: Any) -> Any:
    """Turn a word into an int, float or bool where it reads as one."""
    if not isinstance(value, str):
        return value
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(value.lower(), value)
