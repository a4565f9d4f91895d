"""P4: a ball against a rectangular wall, whose corner is a jump, and against a dome on it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from problems.studies.shared.along_decision import along, both_orders
from problems.studies.study import CODE, StudyParams, quantity_of, setting
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
    sigma: float = setting(0.02, "rad", "noise on the angle", above=0)
    least: float = setting(0.6, "rad", "least angle of the estimates")
    most: float = setting(0.8, "rad", "largest angle of the estimates")
    points: int = setting(61, "1", "angles of the estimates", least=5)
    n_samples: int = setting(1000, "1", "samples of each estimate", least=10)


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
        n = 20 * params.n_samples
        first, zeroth = both_orders(ball, params.sigma, n, params.seed, index)
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
