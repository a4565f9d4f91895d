"""Read ``-s key=value`` settings: a few of our own, the rest the solver's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, get_type_hints

from pydantic import Field

from ocp.errors import choose
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from ocp.typed import read

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
    """Validated settings; ``options`` go to the solver, which knows their types."""

    homotopy: bool | None = None
    strategy: str = DEFAULT_STRATEGY
    factor: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    start: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    jit: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, raw: Mapping[str, Any]) -> Settings:
        """Read strings (or values) by key; raises :class:`~ocp.errors.InputError`."""
        types = get_type_hints(cls, include_extras=True)
        own = {key: read(f"setting {key}", raw[key], types[key]) for key in OWN if key in raw}
        if "strategy" in own:
            choose("strategy", own["strategy"], STRATEGIES)
        options = {k.removeprefix("ipopt."): literal(v) for k, v in raw.items() if k not in OWN}
        return cls(**own, options=options)


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
