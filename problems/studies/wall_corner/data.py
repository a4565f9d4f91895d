"""P4: a ball against a rectangular wall, whose corner is a jump, and against a dome on it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from ocp.studies.estimators import SAMPLED
from ocp.studies.sampling import run_estimator
from problems.spec import Citation
from problems.studies.shared.along_decision import along
from problems.studies.study import (
    CHOICE,
    CODE,
    Claim,
    Study,
    StudyParams,
    over,
    quantity_of,
    setting,
)
from problems.studies.wall_corner.thrown_ball import ThrownBall, Wall

SHAPES = ("rectangle", "dome")
_HALVINGS = 5
_FINER = 20
"""Paths are drawn with this many times smaller steps, or an impact would not be seen to touch."""


class Params(StudyParams):
    """Parameters of P4, from the authors' code but for the noise, which it does not have."""

    v0: float = setting(5.0, "m/s", "speed of the throw", CODE, above=0)
    g: float = setting(9.81, "m/s^2", "gravity", CODE, above=0)
    h: float = setting(0.005, "s", "step size", CODE, above=0)
    T: int = setting(80, "1", "steps", CODE, least=2)
    place: float = setting(1.5, "m", "middle of the wall", CODE, above=0)
    width: float = setting(0.05, "m", "width of the wall, diameter of the dome", CODE, above=0)
    height: float = setting(0.5, "m", "height of the wall", CODE, above=0)
    sigma: float = setting(0.02, "rad", "noise on the angle", CHOICE, above=0)
    least: float = setting(0.6, "rad", "least angle of the estimates", CHOICE)
    most: float = setting(0.8, "rad", "largest angle of the estimates", CHOICE)
    points: int = setting(61, "1", "angles of the estimates", CHOICE, least=5)
    n_samples: int = setting(1000, "1", "samples of each estimate", CHOICE, least=10)


def thrown(params: Params, dome: bool, width: float | None = None) -> ThrownBall:
    """Build the throw; ``width`` [m] replaces the wall's."""
    wall = Wall(params.place, width or params.width, params.height, dome)
    return ThrownBall(wall, params.v0, params.g, params.h, params.T)


def _shrinking(params: Params, corner: float) -> dict:
    """Narrower and narrower domes, thrown at the corner's angle.

    ``beta, Delta, S`` of pathologies, def. III.3, for the event that the dome is missed: the slope
    is then at most that of the rectangle, whose throws never meet a curved surface.
    """
    width = params.width / 2.0 ** np.arange(_HALVINGS)
    at_flat = thrown(params, False).at({"theta": corner})
    noise = Gaussian(params.sigma, np.random.SeedSequence(params.seed, spawn_key=(_HALVINGS,)))
    smooth = 1.02 * float(np.abs(at_flat.differentiated(noise, params.n_samples).direction).max())
    rows = []
    for index, value in enumerate(width):
        ball = thrown(params, True, float(value)).at({"theta": corner})
        seeds = np.random.SeedSequence(params.seed, spawn_key=(index,)).spawn(2)
        first, zeroth = (
            run_estimator(ball, SAMPLED[name], Gaussian(params.sigma, own), 20 * params.n_samples)
            for name, own in zip(("fobg", "zobg-mean"), seeds, strict=True)
        )
        missed = np.abs(first.kept) <= smooth
        inside = first.kept[missed]
        mean = float(zeroth.moments.mean[0])
        rows.append((first.moments.variance[0], zeroth.moments.variance[0], 1 - missed.mean(),
                     abs(inside.mean() - mean), np.abs(inside - inside.mean()).max(),
                     abs(mean)))  # fmt: skip
    names = ("variance_first", "variance_zeroth", "beta", "Delta", "S", "size")
    units = ("m^2/rad^2", "m^2/rad^2", "1", "m/rad", "m/rad", "m/rad")
    found = {
        f"narrow_{name}": quantity_of("width", values, unit, f"{name} at the corner's angle")
        for name, unit, values in zip(names, units, np.transpose(rows), strict=True)
    }
    return {**found, "width": quantity_of("width", width, "m", "diameter of the dome")}


def run(params: Params) -> xr.Dataset:
    """Paths, landing objective, gradients along the angle, and domes that shrink."""
    shown, fine = np.linspace(0.68, 0.73, 15), np.linspace(0.5, 0.9, 4001)
    theta = np.linspace(params.least, params.most, params.points)
    balls = {name: thrown(params, name == "dome") for name in SHAPES}
    cost = {name: ball.costs(fine[:, None]) for name, ball in balls.items()}
    found = {
        name: along(ball, theta, params.sigma, params.n_samples, params.seed + index)
        for index, (name, ball) in enumerate(balls.items())
    }
    smooth = params.model_copy(update={"h": params.h / _FINER, "T": params.T * _FINER})
    drawn = [thrown(smooth, name == "dome").paths(shown) for name in SHAPES]
    jump = np.abs(np.diff(cost["rectangle"]))
    corner = float(fine[int(jump.argmax())])
    slope = "m/rad"

    def stacked(name: str) -> list[np.ndarray]:
        return [getattr(found[shape], name) for shape in SHAPES]

    shapes, narrow = ("shape", "theta"), _shrinking(params, corner)
    width = narrow.pop("width")
    return xr.Dataset(
        {
            "path": quantity_of(("shape", "throw", "node", "axis"),
                                drawn, "m", "position"),
            "f": quantity_of(("shape", "fine"), list(cost.values()), "m", "minus final x"),
            "F": quantity_of(shapes, stacked("F"), "m", "smoothed objective"),
            "slope": quantity_of(shapes, stacked("slope"), slope, "its derivative"),
            "first": quantity_of((*shapes, "moment"), stacked("first"), slope, "FoBG"),
            "zeroth": quantity_of((*shapes, "moment"), stacked("zeroth"), slope, "ZoBG"),
            "first_variance": quantity_of(shapes, stacked("first_variance"), "m^2/rad^2",
                                          "variance of one sample, FoBG"),
            "zeroth_variance": quantity_of(shapes, stacked("zeroth_variance"), "m^2/rad^2",
                                           "variance of one sample, ZoBG"),
            "corner": quantity_of((), corner, "rad", "angle at which the rectangle's f jumps"),
            **narrow,
        },
        {
            "shape": ("shape", list(SHAPES)),
            "axis": ("axis", ["x", "y"]),
            "moment": ("moment", ["mean", "standard error"]),
            "throw": quantity_of("throw", shown, "rad", "angle of the throws drawn"),
            "fine": quantity_of("fine", fine, "rad", "angle"),
            "theta": quantity_of("theta", theta, "rad", "angle"),
            "width": width,
        },
    )  # fmt: skip


def _chance(n: int) -> float:
    """Mean square of n scores of an unbiased estimate that chance exceeds by five deviations."""
    return 1 + 5 * np.sqrt(2 / max(n, 1))


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.6 and fig. 4 say."""
    step = np.abs(np.diff(data["f"].values, axis=1)).max(axis=1)
    size = float(data["fine"][1] - data["fine"][0])
    away = np.abs(data["slope"].values[1][0])
    off = data["first"].values[:, :, 0] - data["slope"].values
    score = off / data["first"].values[:, :, 1]
    worst = [int(np.abs(row).argmax()) for row in off]
    near = np.abs(data["theta"].values - float(data["corner"])) < data.attrs["sigma"]
    dome = float(np.mean(score[1][near] ** 2)) if near.any() else np.nan
    zeroth = (data["zeroth"].values[:, :, 0] - data["slope"].values) / data["zeroth"].values[
        :, :, 1
    ]
    rectangle = float(np.mean(zeroth[0] ** 2))
    width, first = data["width"].values, data["narrow_variance_first"].values
    power = float(np.polyfit(np.log(width), np.log(first), 1)[0])
    rough = data["narrow_variance_zeroth"].values
    beta, Delta, scale = (data[f"narrow_{n}"].values for n in ("beta", "Delta", "size"))
    high, biased = first >= 2 * rough, (beta < 0.1) & (Delta > 0.5 * scale)
    place = "Pathologies, ex. III.6"
    return [
        Claim("A rectangular wall makes the objective jump", place, "a jump at the corner",
              f"{step[0]:.3f} m at {float(data['corner']):.4f} rad", bool(step[0] > 0.05)),
        Claim("With a dome it is continuous, but stiff", place, "steep, no jump",
              f"steps of at most {step[1]:.1e} m: slope {step[1] / size:.1f} m/rad against"
              f" {away:.1f} away", bool(step[1] < 1e-2 and step[1] / size > 2 * away)),
        Claim("FoBG is biased at the rectangle", place, "error beyond its interval",
              f"{off[0][worst[0]]:+.2f} m/rad, {abs(score[0][worst[0]]):.0f} standard errors",
              bool(abs(score[0][worst[0]]) > 10)),
        Claim("ZoBG is not", "Pathologies, sec. III-A", "errors of 1 standard error",
              f"{np.sqrt(rectangle):.2f} rms", rectangle < _chance(zeroth[0].size)),
        Claim("With a dome FoBG is no longer biased asymptotically", place,
              "errors of 1 standard error", f"{np.sqrt(dome):.2f} rms near the corner",
              dome < _chance(near.sum())),
        Claim("The stiffness still results in high variance", "our check",
              "twice ZoBG's or more", f"domes {over(list(width), high)} m wide: "
              + ", ".join(f"{part:.2g}" for part in first / rough) + " times", bool(np.all(high))),
        Claim("It grows as the dome shrinks towards the corner, ZoBG's does not", "our check",
              "as 1/width", f"width to the power {power:.2f}; ZoBG {rough.min():.1f} to"
              f" {rough.max():.1f} m²/rad²",
              bool(-1.3 < power < -0.7 and rough.max() < 3 * rough.min())),
        Claim("The dome results in high empirical bias", place,
              "off by |F'|/2 or more where the dome is missed, in nine of ten cases",
              f"domes {over(list(width), biased)} m wide: met with probability "
              + ", ".join(f"{b:.2f}" for b in beta) + ", off by "
              + ", ".join(f"{d:.2f}" for d in Delta / scale) + " of |F'|", bool(np.all(biased))),
        Claim("It does as the dome shrinks", "our check", "the same at the narrowest",
              f"met with probability {beta[-1]:.3f}, off by {Delta[-1] / scale[-1]:.2f} of |F'| at"
              f" {width[-1]:g} m", bool(biased[-1])),
    ]  # fmt: skip


study = Study(
    id="P4",
    title="A ball against the corner of a wall, and against a dome",
    citation=Citation("suh2022pathologies", "Fig. 4 and example III.6"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "Impacts are elastic mirror reflections inside a step; the authors' 0.9 of restitution is"
        " declared there, not used. The ground, at y = -0.1 m, is out of reach within the flight.",
        "The dome sits on the wall, its diameter the wall's width.",
    ),
)
