"""P6: implicit time stepping and its log-barrier relaxation, for one step in front of the wall."""

from __future__ import annotations

import casadi as ca
import numpy as np
import xarray as xr

from dynamics.contact import Barrier, Exact
from problems.registry import get
from problems.studies.shared.sampled_step import SampledStep
from problems.studies.study import Claim, StudyParams, claim, dataset, format_values, setting

NOTES = (
    "The barrier weight and the central-path parameter are the same: mu = h/kappa for a gap in"
    " position, and lam is an impulse.",
    "The text calls kappa the weight of the barrier; the weight is 1/kappa.",
)

KAPPAS = (10.0, 50.0, 100.0, 500.0, 1000.0)
"""Log-barrier weights of the curves [1/J]."""


class Params(StudyParams):
    """Parameters of study P6; all defaults are our choice, since the paper draws the curves without values."""

    m: float = setting(1.0, "kg", "mass", above=0)
    h: float = setting(0.1, "s", "step size", above=0)
    u_max: float = setting(1.0, "N s", "largest input impulse drawn", above=0)
    points: int = setting(201, "1", "inputs drawn, an odd number", least=3)


def eq5(x: np.ndarray, v: np.ndarray, u: np.ndarray, kappa: np.ndarray, m: float, h: float) -> np.ndarray:
    """Return the next position [m] of Suh et al. 2022, eq. 5: ``x+ = h s``, ``s = (s0 + sqrt(s0² + 4/(kappa m)))/2``.

    ``s0 = x/h + v + u/m``. For s0 < 0, s is computed as ``2/(kappa m)/(r - s0)``, with r the square root.
    """
    s0 = x / h + v + u / m
    r = np.sqrt(s0**2 + 4 / (kappa * m))
    return h * np.where(s0 > 0, (s0 + r) / 2, 2 / (kappa * m) / (r - s0))


def solve_qp(x: np.ndarray, v: np.ndarray, u: np.ndarray, m: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x+ [m] and lam [N s] from the QP of Suh et al. 2022, eq. 3, at n points, by an active-set method.

    ``min m/2 (v+ - v)² - u v+`` subject to ``x/h + v+ >= 0``; lam is the multiplier of the constraint.
    """
    scalar = ca.DM.ones(1, 1)
    quiet = {"print_iter": False, "print_header": False, "print_info": False}
    solver = ca.conic("qp", "qrqp", {"h": scalar.sparsity(), "a": scalar.sparsity()}, quiet)
    solutions = [
        solver(h=m * scalar, a=scalar, g=-(m * b + c), lba=-a / h, uba=np.inf) for a, b, c in zip(x, v, u, strict=True)
    ]
    velocity, lam = (np.array([float(qp_solution[key]) for qp_solution in solutions]) for key in ("x", "lam_a"))
    return x + h * velocity, -lam


def newton_step(
    x: np.ndarray, v: np.ndarray, u: np.ndarray, kappa: np.ndarray, x_next: np.ndarray, m: float, h: float
) -> np.ndarray:
    """Return the Newton step (n,) [m] from ``x_next`` (n,) to the minimum of eq. 4, a strictly convex objective."""
    inputs = [ca.SX.sym(name) for name in ("x", "v", "u", "kappa", "w")]
    position, velocity, push, weight, w = inputs
    objective = m / 2 * (w - velocity) ** 2 - push * w - ca.log(position / h + w) / weight
    bend, slope = ca.hessian(objective, w)
    step = ca.Function("newton", inputs, [h * slope / bend])
    return np.array(step(*(a[None] for a in (x, v, u, kappa, (x_next - x) / h)))).ravel()


def run(params: Params) -> xr.Dataset:
    """Compute the next position over u from (x, v) = 0 under the exact law and the barrier at each kappa."""
    system = get("wall-1d", m=params.m, h=params.h).system
    u = params.u_max * np.linspace(-1, 1, params.points // 2 * 2 + 1)
    exact = SampledStep(Exact().close(system))(np.zeros((1, 2)), u[:, None])
    x_qp, _ = solve_qp(np.zeros_like(u), np.zeros_like(u), u, params.m, params.h)
    barrier = SampledStep(Barrier(kappa=1.0).close(system))
    shape = (len(KAPPAS), len(u))
    kappa = np.repeat(KAPPAS, len(u))
    relaxed = barrier(np.zeros((1, 2)), np.tile(u, len(KAPPAS))[:, None], kappa=kappa)
    closed = eq5(np.zeros(1), np.zeros(1), np.tile(u, len(KAPPAS)), kappa, params.m, params.h)
    rng = np.random.default_rng(params.seed)
    x, v, w = rng.uniform(0, 1, 1000), *rng.uniform(-3, 3, (2, 1000))
    random_kappa = 10 ** rng.uniform(0, 6, 1000)
    states = np.stack((x, v), 1)
    at_random = barrier(states, w[:, None], kappa=random_kappa)
    stepped = SampledStep(Exact().close(system))(states, w[:, None])
    qp, multiplier = solve_qp(x, v, w, params.m, params.h)
    reference = eq5(x, v, w, random_kappa, params.m, params.h)
    newton = newton_step(x, v, w, random_kappa, at_random.x_next[:, 0], params.m, params.h)
    dimensions = ("kappa", "u")
    return dataset(
        {
            "x_qp": ("u", x_qp, "m", "next position, QP of eq. 3"),
            "x_barrier": (dimensions, relaxed.x_next[:, 0].reshape(shape), "m", "next position, log barrier"),
            "x_eq5": (dimensions, closed.reshape(shape), "m", "closed form of eq. 5"),
            "slope_exact": ("u", exact.x_by_u[:, 0, 0], "m/(N s)", "dx+/du, time stepping"),
            "slope_barrier": (dimensions, relaxed.x_by_u[:, 0, 0].reshape(shape), "m/(N s)", "dx+/du, log barrier"),
            "lam_barrier": (dimensions, relaxed.lam[:, 0].reshape(shape), "N s", "impulse of the wall, log barrier"),
            "eq5_error": (
                "sample",
                at_random.x_next[:, 0] - reference,
                "m",
                "next position less that of eq. 5 at random x, v, u, kappa",
            ),
            "newton": ("sample", newton, "m", "Newton's step of eq. 4 from that next position"),
            "qp_error": (
                "sample",
                stepped.x_next[:, 0] - qp,
                "m",
                "next position by time stepping less that of the QP",
            ),
            "lam_error": (
                "sample",
                stepped.lam[:, 0] - multiplier,
                "N s",
                "impulse by time stepping less the QP's multiplier",
            ),
        },
        {"u": (u, "N s", "input impulse"), "kappa": (KAPPAS, "1/J", "log-barrier weight")},
    )


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Suh et al. 2022, ex. IV.1, ex. IV.2 and fig. 6."""
    m, h = data.attrs["m"], data.attrs["h"]
    error, newton = (float(np.abs(data[name]).max()) for name in ("eq5_error", "newton"))
    qp, multiplier = (float(np.abs(data[name]).max()) for name in ("qp_error", "lam_error"))
    cases = f"over {data.sizes['sample']} random cases"
    differences = (data["x_barrier"] - data["x_qp"]).values
    largest = differences.max(axis=1)
    middle = int(np.abs(data["u"].values).argmin())
    kink = differences[:, middle] * np.sqrt(m * data["kappa"].values) / h
    scaled = differences[:, -1] * data["kappa"].values
    slope = data["slope_exact"].values
    relu = np.abs(slope - (h / m) * (data["u"].values > 0))[np.abs(data["u"].values) > 0].max()
    kappas = data["kappa"].values[:, None]
    product = np.abs(data["lam_barrier"].values * data["x_barrier"].values * kappas / h - 1).max()
    power = float(np.polyfit(np.log(kappas[:, 0]), np.log(largest), 1)[0])
    steepest = float(data["slope_barrier"].max())
    return [
        claim("The optimality condition (5) is that of the objective (4)", "Pathologies, eq. 4-5")
        .expected("0")
        .measured(f"its step is off the minimiser by {newton:.1e} m {cases}")
        .below(newton, 1e-9),
        claim("It gives the next state in closed form", "closed form of eq. 5")
        .expected("0")
        .measured(f"{error:.1e} m {cases}")
        .below(error, 1e-12),
        claim("The equations of motion (2) are the KKT condition of the QP (3)", "Pathologies, ex. IV.1")
        .expected("same x+, and lam its multiplier")
        .measured(f"x+ within {qp:.1e} m, lam within {multiplier:.1e} N s {cases}")
        .holds(qp < 1e-9, multiplier < 1e-9),
        claim("x+ over u is a kinked line", "Pathologies, fig. 6")
        .expected("slope 0, then h/m")
        .measured(f"off by {relu:.1e} m/(N s)")
        .below(relu, 1e-12),
        claim("As kappa grows, the solution of (4) converges to that of (3)", "Pathologies, ex. IV.2")
        .expected("0 at kappa = inf")
        .measured(
            format_values(largest, ".1e")
            + " m at kappa = "
            + format_values(kappas[:, 0], "g")
            + " per J, as kappa to the power"
            f" {power:.2f}"
        )
        .holds(np.diff(largest) < 0, -1.1 < power < -0.4),
        claim("That convergence is slow at the kink only: x+ = h/sqrt(m kappa) there", "closed form of eq. 5")
        .expected("x+ sqrt(m kappa)/h = 1")
        .measured(
            f"{kink.min():.6f} to {kink.max():.6f}; off it, difference*kappa {scaled[0]:.3g} to {scaled[-1]:.3g} m/J"
        )
        .holds(np.allclose(kink, 1, rtol=1e-9)),
        claim("No spring constant: the gradient stays bounded however hard the wall", "Pathologies, fig. 6")
        .expected(f"|dx+/du| <= h/m = {h / m:g}")
        .measured(f"{steepest:.6g} m/(N s)")
        .at_most(steepest, h / m),
        claim("The wall exerts a force inversely proportional to the distance", "Pathologies, ex. IV.2")
        .expected("lam x+ kappa/h = 1")
        .measured(f"within {product:.1e}, x+ after the step and lam an impulse")
        .below(product, 1e-9),
    ]
