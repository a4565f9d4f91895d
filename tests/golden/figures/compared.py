"""Synthetic data of study N3, without a solve."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from problems.studies.smoothings_compared.data import Params, run
from problems.studies.study import FinishedParts

SEEDS = 2
SETTINGS = Params(seeds=SEEDS)


class Made(FinishedParts):
    """Finished parts with synthetic costs of plan and replay, which depend on the key."""

    def __init__(self, costs: Callable[[str], tuple[float, float]]) -> None:
        super().__init__()
        self.costs, self.keys = costs, []

    def get(self, key: str, make: object) -> dict[str, np.ndarray]:
        self.keys.append(key)
        plan, replay = self.costs(key)
        return {"told": np.array([plan, replay, replay <= 1.1 * plan, 7, 2.0, 3.0])}


def compared(costs: Callable[[str], tuple[float, float]]) -> xr.Dataset:
    data = run(SETTINGS, Made(costs))
    return data.assign_attrs({"study": "N3", **SETTINGS.model_dump()})
