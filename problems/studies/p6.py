"""P6: implicit time stepping against its log-barrier relaxation, one step from the wall."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.contact import Barrier, Exact
from problems.registry import get
from problems.spec import Citation
from problems.studies.sampled_step import SampledStep
from problems.studies.study import CHOICE, Claim, Study, StudyParams, quantity_of, setting

KAPPAS = (10.0, 50.0, 100.0, 500.0, 1000.0)
_PLACE = "Pathologies, "


class Params(StudyParams):
    """Parameters of P6; the paper draws the curves without any values."""

    m: float = setting(1.0, "kg", "mass", CHOICE, above=0)
    h: float = setting(0.1, "s", "step size", CHOICE, above=0)
    u_max: float = setting(1.0, "N s", "largest input impulse drawn", CHOICE, above=0)
    points: int = setting(201, "1", "inputs drawn", CHOICE, least=3)


def eq5(
    x: np.ndarray, v: np.ndarray, u: np.ndarray, kappa: np.ndarray, m: float, h: float
) -> np.ndarray:
    """Next position by pathologies eq. 5: ``x+ = h s``, ``s = (s0 + sqrt(s0² + 4/(kappa m)))/2``.

    ``s0 = x/h + v + u/m``; for s0 < 0 the same root as ``2/(kappa m)/(r - s0)``.
    """
    s0 = x / h + v + u / m
    r = np.sqrt(s0**2 + 4 / (kappa * m))
    return h * np.where(s0 > 0, (s0 + r) / 2, 2 / (kappa * m) / (r - s0))


def run(params: Params) -> xr.Dataset:
    """Next position over u from (x, v) = 0, under the exact law and the barrier at each kappa."""
    system = get("wall-1d", m=params.m, h=params.h).system
    u = np.linspace(-params.u_max, params.u_max, params.points)
    exact = SampledStep(Exact().close(system))(np.zeros((1, 2)), u[:, None])
    barrier = SampledStep(Barrier(kappa=1.0).close(system))
    shape = (len(KAPPAS), len(u))
    kappa = np.repeat(KAPPAS, len(u))
    found = barrier(np.zeros((1, 2)), np.tile(u, len(KAPPAS))[:, None], contact__kappa=kappa)
    closed = eq5(np.zeros(1), np.zeros(1), np.tile(u, len(KAPPAS)), kappa, params.m, params.h)
    rng = np.random.default_rng(params.seed)
    x, v, w = rng.uniform(0, 1, 1000), *rng.uniform(-3, 3, (2, 1000))
    random_kappa = 10 ** rng.uniform(0, 6, 1000)
    at_random = barrier(np.stack((x, v), 1), w[:, None], contact__kappa=random_kappa)
    reference = eq5(x, v, w, random_kappa, params.m, params.h)
    both = ("kappa", "u")
    return xr.Dataset(
        {
            "x_exact": quantity_of("u", exact.x_next[:, 0], "m", "next position, QP"),
            "x_barrier": quantity_of(both, found.x_next[:, 0].reshape(shape), "m",
                                     "next position, log barrier"),
            "x_eq5": quantity_of(both, closed.reshape(shape), "m", "closed form of eq. 5"),
            "slope_exact": quantity_of("u", exact.x_by_u[:, 0, 0], "m/(N s)", "dx+/du, QP"),
            "slope_barrier": quantity_of(both, found.x_by_u[:, 0, 0].reshape(shape), "m/(N s)",
                                         "dx+/du, log barrier"),
            "lam_barrier": quantity_of(both, found.lam[:, 0].reshape(shape), "N s",
                                       "impulse of the wall, log barrier"),
            "eq5_error": quantity_of("sample", at_random.x_next[:, 0] - reference, "m",
                                     "next position less that of eq. 5 at random x, v, u, kappa"),
        },
        {
            "u": quantity_of("u", u, "N s", "input impulse"),
            "kappa": quantity_of("kappa", KAPPAS, "1/J", "log-barrier weight"),
        },
    )  # fmt: skip


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. IV.1-2 and fig. 6 say."""
    m, h = data.attrs["m"], data.attrs["h"]
    error = float(np.abs(data["eq5_error"]).max())
    off = (data["x_barrier"] - data["x_exact"]).values
    largest = off.max(axis=1)
    middle = int(np.abs(data["u"].values).argmin())
    kink = off[:, middle] * np.sqrt(m * data["kappa"].values) / h
    far = off[:, -1] * data["kappa"].values
    slope = data["slope_exact"].values
    relu = np.abs(slope - (h / m) * (data["u"].values > 0))[np.abs(data["u"].values) > 0].max()
    kappas = data["kappa"].values[:, None]
    product = np.abs(data["lam_barrier"].values * data["x_barrier"].values * kappas / h - 1).max()
    steepest = float(data["slope_barrier"].max())
    return [
        Claim("The optimality condition (5) gives the next state of (4) in closed form",
              _PLACE + "eq. 5", "0", f"{error:.1e} m over 1000 random cases", error < 1e-12),
        Claim("Time stepping is the KKT system of the QP: x+ over u is a kinked line",
              _PLACE + "eq. 2-3, fig. 6", "slope 0, then h/m",
              f"off by {relu:.1e} m/(N s)", bool(relu < 1e-12)),
        Claim("As kappa grows, the solution of (4) converges to that of (3)",
              _PLACE + "ex. IV.2", "0 at kappa = inf",
              f"{largest[0]:.1e} m at 10/J, {largest[-1]:.1e} m at 1000/J",
              bool(np.all(np.diff(largest) < 0))),
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
              f"1 within {product:.1e}, x+ after the step and lam an impulse",
              bool(product < 1e-9)),
    ]  # fmt: skip


study = Study(
    id="P6",
    title="Implicit time stepping and its log-barrier relaxation",
    citation=Citation("suh2022pathologies", "Fig. 6, examples IV.1 and IV.2"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "The barrier weight and the central-path parameter are one knob: mu = h/kappa for a gap in"
        " position, and lam is an impulse.",
        "The text calls kappa the weight of the barrier; the weight is 1/kappa.",
    ),
)
