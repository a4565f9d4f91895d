"""Synthetic runs of a system of any size, for tests of pages without a solve."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import xarray as xr

from dynamics.systems import signals
from dynamics.systems.pairs import Pair
from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from reports.drawing.view import RunView

TIME = ("scenario", "interval")


def run(
    states: dict[str, np.ndarray],
    inputs: dict[str, np.ndarray],
    contacts: dict[str, np.ndarray],
    *,
    replay: dict[str, np.ndarray] | None = None,
    gap: np.ndarray | None = None,
    mu: float = 0.0,
    kinds: list[str] | None = None,
    h: float = 0.1,
) -> RunView:
    """Return a run with states (S, N+1), inputs and multipliers (S, N), given as dicts ``{"name [unit]": array}``.

    ``replay`` has the arrays ``x``, ``u`` or ``lam`` of the replay if they are different.
    """
    x, u, lam = (np.stack(list(part.values()), axis=-1) for part in (states, inputs, contacts))
    replay = replay or {}
    gaps = np.zeros_like(lam) if gap is None else gap
    nodes, N = ("scenario", "node", "state"), x.shape[1] - 1
    data = xr.Dataset(
        {
            "x": (nodes, x),
            "x_replay": (nodes, replay.get("x", x)),
            "u": ((*TIME, "control"), u),
            "u_replay": ((*TIME, "control"), replay.get("u", u)),
            "lam": ((*TIME, "contact"), lam),
            "gap": ((*TIME, "contact"), gaps),
            "lam_replay": ((*TIME, "contact"), replay.get("lam", lam)),
            "gap_replay": ((*TIME, "contact"), gaps),
            "mu": ((*TIME, "contact"), np.full_like(lam, mu)),
        },
        coords={"time": ("node", h * np.arange(N + 1))},
    )
    pairs = [Pair(cast(Any, kind), i) for i, kind in enumerate(kinds or ["normal"] * len(contacts))]
    system = SimpleNamespace(
        states=signals("; ".join(states)),
        inputs=signals("; ".join(inputs)),
        contacts=signals("; ".join(contacts)),
        pairs=tuple(pairs),
        gap_unit="m",
        forces=None,
    )
    meta = {"kind": "solve", "problem": "made", "record": {"contact": "exact"}}
    scales = SimpleNamespace(impulse=1.0, gap=1.0)
    problem = cast(Any, SimpleNamespace(system=system, scales=scales))
    return RunView(StoredRun(Path("runs/made"), LabelledArrays.of(data), meta), None, None, problem)


def waves(count: int, unit: str, steps: int, prefix: str) -> dict[str, np.ndarray]:
    """Return ``count`` components of one unit that vary in time, each (1, steps)."""
    t = np.linspace(0, 1, steps)
    return {f"{prefix}{i} [{unit}]": np.cos(t + i)[None] for i in range(count)}
