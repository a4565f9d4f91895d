"""What AT's data say of theorem 4.2."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.convergence_bound.data import bound
from problems.studies.study import Claim, over


def claims(data: xr.Dataset) -> list[Claim]:
    """The bound, how far it is from what it bounds, and which of its terms rules."""
    laws = [str(law) for law in data["law"].values]
    sides = [bound(data, law) for law in laws]
    held = [left <= right for left, right in sides]
    ratios = [right / left for left, right in sides]
    inside = np.isfinite(data["value"].values).all()
    bias = [float(data["bias"].sel(law=law).mean()) for law in laws]
    variance = [float(data["variance"].sel(law=law).mean()) for law in laws]
    smooth = [k for k, law in enumerate(laws) if law != "exact"]
    lower = [variance[k] < variance[0] for k in smooth]
    higher = [bias[k] > bias[0] for k in smooth]
    gains = (data["value"][..., -1] - data["value"][..., 0]).mean("run").values
    closest = laws[int(np.argmax(gains))]
    unit = data["bias"].attrs["units"]
    least = laws[int(np.argmin(bias))]
    return [
        Claim("The smallest mean square gradient is below the bound", "ABS, thm. 4.2",
              "left side at most the right one, under every law",
              f"{over(laws, held)}: {', '.join(f'{a:.2g} <= {b:.2g}' for a, b in sides)}",
              all(held) and bool(inside)),
        Claim("The bound tells the size of what it bounds", "our check",
              "at most 10 times as large", ", ".join(f"{ratio:.3g}" for ratio in ratios),
              max(ratios) <= 10),
        Claim("Smoothing lowers the gradient's variance", "ABS, sec. 4.3",
              "below the exact law's, mean over steps and runs",
              f"{over([laws[k] for k in smooth], lower)}: exact {variance[0]:.3g}, then"
              f" {', '.join(f'{variance[k]:.3g}' for k in smooth)}"
              f" {data['variance'].attrs['units']}", all(lower)),
        Claim("Smoothing adds bias", "ABS, sec. 5.1", "above the exact law's",
              f"{over([laws[k] for k in smooth], higher)}: exact {bias[0]:.3g}, then"
              f" {', '.join(f'{bias[k]:.3g}' for k in smooth)} {unit}", all(higher)),
        Claim("The law of the least bias climbs the most", "our check",
              f"{least}, of the least mean bias", f"{closest} gained {gains.max():.3g} {unit}",
              closest == least),
    ]  # fmt: skip
