"""What P6's data say of ex. IV.1-2 and fig. 6."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, listed

_PLACE = "Pathologies, "


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. IV.1-2 and fig. 6 say."""
    m, h = data.attrs["m"], data.attrs["h"]
    error, newton = (float(np.abs(data[name]).max()) for name in ("eq5_error", "newton"))
    qp, multiplier = (float(np.abs(data[name]).max()) for name in ("qp_error", "lam_error"))
    cases = f"over {data.sizes['sample']} random cases"
    off = (data["x_barrier"] - data["x_qp"]).values
    largest = off.max(axis=1)
    middle = int(np.abs(data["u"].values).argmin())
    kink = off[:, middle] * np.sqrt(m * data["kappa"].values) / h
    far = off[:, -1] * data["kappa"].values
    slope = data["slope_exact"].values
    relu = np.abs(slope - (h / m) * (data["u"].values > 0))[np.abs(data["u"].values) > 0].max()
    kappas = data["kappa"].values[:, None]
    product = np.abs(data["lam_barrier"].values * data["x_barrier"].values * kappas / h - 1).max()
    power = float(np.polyfit(np.log(kappas[:, 0]), np.log(largest), 1)[0])
    steepest = float(data["slope_barrier"].max())
    return [
        Claim("The optimality condition (5) is that of the objective (4)", _PLACE + "eq. 4-5",
              "0", f"its step is off the minimiser by {newton:.1e} m {cases}", newton < 1e-9),
        Claim("It gives the next state in closed form", "closed form of eq. 5", "0",
              f"{error:.1e} m {cases}", error < 1e-12),
        Claim("The equations of motion (2) are the KKT condition of the QP (3)",
              _PLACE + "ex. IV.1", "same x+, and lam its multiplier",
              f"x+ within {qp:.1e} m, lam within {multiplier:.1e} N s {cases}",
              bool(qp < 1e-9 and multiplier < 1e-9)),
        Claim("x+ over u is a kinked line", _PLACE + "fig. 6", "slope 0, then h/m",
              f"off by {relu:.1e} m/(N s)", bool(relu < 1e-12)),
        Claim("As kappa grows, the solution of (4) converges to that of (3)",
              _PLACE + "ex. IV.2", "0 at kappa = inf",
              listed(largest, ".1e") + " m at kappa = "
              + listed(kappas[:, 0], "g") + " per J, as kappa to the power"
              f" {power:.2f}", bool(np.all(np.diff(largest) < 0) and -1.1 < power < -0.4)),
        Claim("That convergence is slow at the kink only: x+ = h/sqrt(m kappa) there",
              "closed form of eq. 5", "x+ sqrt(m kappa)/h = 1",
              f"{kink.min():.6f} to {kink.max():.6f}; off it, difference*kappa"
              f" {far[0]:.3g} to {far[-1]:.3g} m/J",
              bool(np.allclose(kink, 1, rtol=1e-9))),
        Claim("No spring constant: the gradient stays bounded however hard the wall",
              _PLACE + "fig. 6", f"|dx+/du| <= h/m = {h / m:g}", f"{steepest:.6g} m/(N s)",
              steepest <= h / m),
        Claim("The wall exerts a force inversely proportional to the distance",
              _PLACE + "ex. IV.2", "lam x+ kappa/h = 1",
              f"within {product:.1e}, x+ after the step and lam an impulse",
              bool(product < 1e-9)),
    ]  # fmt: skip
