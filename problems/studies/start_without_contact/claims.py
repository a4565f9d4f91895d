"""What N2's data say of sec. V-B."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ocp import Status
from ocp.judges.referee import COST_SHARE
from problems.studies.start_without_contact.open_loop import LAWS, PROBLEMS
from problems.studies.study import Claim, listed, over

_PROGRESS = 0.8
"""Part of the object's cost at rest that a plan saves, to have made progress."""


def claims(data: xr.Dataset) -> list[Claim]:
    """What sec. V-B says of the exact and the smoothed dynamics, and what a replay keeps."""
    return [claim for name in PROBLEMS for claim in _claims(name, data.sel(problem=name))]


def _claims(name: str, data: xr.Dataset) -> list[Claim]:
    """Of one problem: stuck under the exact law, moved under the smoothed ones, replayed."""
    place = "Noising data, sec. V-B and fig. 2"
    smooth = [law for law in LAWS if law != "exact"]
    rest, stuck, _ = (float(v) for v in data["cost"].sel(law="exact"))
    word = str(data["status"].sel(law="exact").values)
    fall = {law: 1 - float(data["cost"].sel(law=law, of="plan")) / rest for law in smooth}
    plan, replay = data["total"].sel(law=smooth).values.T
    dearer = (replay - plan) / np.abs(plan)
    kept = dearer <= COST_SHARE
    others = [law for law in smooth if law != "randomized"]
    moved = [fall[law] >= _PROGRESS for law in others]
    expected = f"the object's cost falls by {_PROGRESS:.0%} or more"
    return [
        Claim(f"{name}: the exact dynamics make no progress from a start without contact", place,
              "the object's cost as at rest", f"{stuck:.6g} of {rest:.6g}, {word}",
              bool(abs(stuck - rest) <= 1e-9 * rest and word == Status.NO_PROGRESS.label)),
        Claim(f"{name}: randomized smoothing makes progress", place, expected,
              f"{fall['randomized']:.1%}", bool(fall["randomized"] >= _PROGRESS)),
        Claim(f"{name}: so do the barrier and the adaptive law", "our check", expected,
              f"{over(others, moved)}: " + ", ".join(f"{fall[law]:.1%}" for law in others),
              bool(all(moved))),
        Claim(f"{name}: the plan keeps its cost under the exact law", "our check",
              f"its replay costs at most {COST_SHARE:.0%} more, of all of the cost",
              f"{over(smooth, kept)}: " + listed(dearer, "+.1%"), bool(np.all(kept))),
    ]  # fmt: skip
