"""What A2's data say of fig. 2, sec. 7.1 and C.1."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.bouncing_ball.data import FINE, MUS, REBOUND_MU
from problems.studies.study import Claim, largest, listed


def claims(data: xr.Dataset) -> list[Claim]:
    """What fig. 2, sec. 7.1 and C.1 say."""
    g, q0, h = data.attrs["g"], data.attrs["q0"], data.attrs["h"]
    peak = data["rate"].values.max(axis=1)
    peak_step = data["rate_step"].values.max(axis=1)
    free = np.sqrt(2 * q0 / g)
    fall = data["rate_exact"].values[data["q_mid"].values < free - h] * data.attrs["v0"]
    velocity = data["v_exact"].values
    jump = float((velocity[2:] - velocity[:-2]).max())
    drift, apex = float(data["energy_drift"].max()), data["apex"].values
    rebound = data["rebound"].values
    rest = largest(data["y_exact"].values[data["q_step"].values > free + 2 * h])
    least = np.abs(data["least"].values / data["least_closed"].values - 1).max()
    return [
        Claim("In the exact LCS the velocity falls at -g and jumps at contact", "ABS, fig. 2",
              f"dv_y/dt = {-g:g}, then a jump", f"{fall.mean():.4f} m/s², jump {jump:.3f} m/s over"
              " two steps", bool(np.allclose(fall, -g) and jump > 0.9 * g * free)),
        Claim("Larger mu makes the dynamics less stiff", "ABS, sec. 7.1", "lower peak of dv/dq",
              listed(peak, ".3g") + " 1/s", bool(np.all(np.diff(peak) < 0))),
        Claim("The same by time stepping", "ABS, sec. 7.1", "lower peak of dv/dq",
              listed(peak_step, ".3g") + " 1/s", bool(np.all(np.diff(peak_step) < 0))),
        Claim("(C.1) is the softened ball", "ABS, C.1", "y'' = mu/y - g",
              f"{float(data['printed_error']):.1e} m/s apart at mu = {MUS[-1]:g}",
              float(data["printed_error"]) < 1e-6),
        Claim("Solving (C.1) gives the behaviour of the LCS, which does not bounce", "our check",
              f"height regained {rest:.3g} m", f"{apex.min():.4f} to {apex.max():.4f} m: energy"
              f" kept within {drift:.0e}", bool(apex.max() < 0.1 * q0)),
        Claim("Least height is -(mu/g) W0(-(g/mu) exp(-E/mu))", "closed form", "equal",
              f"within {least:.1e} relative", bool(least < 1e-6)),
        Claim("Time stepping at fixed mu tends to that elastic ball as h falls",
              "our check of C.1", f"{q0:g} m", listed(rebound, ".2f")
              + f" m at h = {FINE[0]:g} to {FINE[-1]:g} s, mu = {REBOUND_MU:g}",
              bool(np.all(np.diff(rebound) > 0) and rebound[-1] > 0.9 * q0)),
    ]  # fmt: skip
