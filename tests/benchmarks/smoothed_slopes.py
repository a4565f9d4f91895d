"""Slopes of scenes under smoothing laws over mu, sigma and h: their bias, their variance, and their cost in time.

``python -m tests.benchmarks.smoothed_slopes`` measures all and rewrites the site's table.
"""

from __future__ import annotations

import time

import numpy as np

from docs.generator.measured import write_table
from ocp.gradients.worlds import World
from ocp.gradients.worlds.measures import nearby_points
from problems.gradient_scenes import SCENES, Scene
from problems.gradient_scenes.worlds import scene_world

TABLE = "smoothed-slopes"
SMOOTH_SCENES = ("oblique-drop", "slide-to-rest", "wall-spring", "two-balls", "stick-slip")
"""Scenes whose exact slope is neither zero nor undefined, and in which our laws see the time of impact."""
AFAR = "push-from-afar"
"""Scene whose exact slope is zero, while secants over a tenth of the force are not."""
STEPS_S = (0.02, 0.01, 0.0025)
"""Step sizes [s]."""
LAWS = {
    "exact": ("", (0.0,)),
    "barrier": ("mu", (1e-3, 1e-4, 1e-5, 1e-7)),
    "adaptive": ("sigma", (1e-2, 1e-3, 1e-4)),
    "randomized": ("sigma", (1.0, 0.1, 0.01)),
}
"""Mapping from laws to the setting that smooths, and its values."""
NOISE_SHARE, SAMPLES = 0.1, 2000
"""Standard deviation of the noise of estimators, as a share of the parameter, and number of samples."""


def digits(value: float) -> str:
    """Return a number with two digits, without an exponent where it is large."""
    return f"{float(f'{value:.2g}'):g}"


def errors(scene: Scene, world: World) -> np.ndarray:
    """Return the errors (17,) of slopes at and near the nominal parameter, as shares of the exact slopes."""
    theta = nearby_points(scene.theta, abs(scene.theta))[:, None]
    exact = scene.truth.gradient(theta)[:, 0, 0]
    return np.abs(world.gradient(theta)[:, 0, 0] / exact - 1)


def deviations(scene: Scene, world: World) -> np.ndarray:
    """Return the standard deviations of one sample of the zeroth and the first order, as shares of the exact slope."""
    w = NOISE_SHARE * abs(scene.theta) * np.random.default_rng(0).normal(size=(SAMPLES, 1))
    values = [world.rollout(scene.theta + sign * w)[:, 0] for sign in (1, -1)]
    zeroth = (values[0] - values[1]) * w[:, 0] / (2 * (NOISE_SHARE * scene.theta) ** 2)
    first = world.gradient(scene.theta + w)[:, 0, 0]
    exact = abs(scene.truth.gradient(np.array([[scene.theta]]))[0, 0, 0])
    return np.array([zeroth.std(), first.std()]) / exact


def row(law: str, setting: str, value: float, h: float) -> list[str]:
    """Return the cells of one law at one value of its setting and one step size."""
    changes = {"h": h, **({setting: value} if setting else {})}
    worlds = {name: scene_world(SCENES[name], law).at(changes) for name in (*SMOOTH_SCENES, AFAR)}
    shares = np.array([errors(SCENES[name], worlds[name]) for name in SMOOTH_SCENES])
    medians = np.median(shares, axis=1)
    spread = np.median([deviations(SCENES[name], worlds[name]) for name in SMOOTH_SCENES], axis=0)
    afar = SCENES[AFAR]
    reach = np.array([[0.9 * afar.theta], [1.1 * afar.theta]])
    secant = float(np.diff(afar.truth.rollout(reach)[:, 0])[0]) / float(np.diff(reach[:, 0])[0])
    seen = worlds[AFAR].gradient(np.array([[afar.theta]]))[0, 0, 0] / secant
    theta = np.full((SAMPLES, 1), SCENES["oblique-drop"].theta)
    began = time.process_time()
    worlds["oblique-drop"].gradient(theta)
    micros = 1e6 * (time.process_time() - began) / SAMPLES
    cells = [f"{law} {setting} {value:g}" if setting else law, f"{1e3 * h:g}", f"{digits(100 * np.median(medians))} %"]
    cells += [f"{digits(100 * medians.max())} % ({SMOOTH_SCENES[int(medians.argmax())]})"]
    cells += [digits(each) for each in (seen, *spread, micros)]
    print(*cells, sep=" | ", flush=True)
    return cells


def main() -> None:
    """Measure every law at every step size, and write the table."""
    rows = [row(law, setting, value, h) for law, (setting, values) in LAWS.items() for value in values for h in STEPS_S]
    write_table(
        TABLE,
        title="What smoothing does to a slope",
        command="python -m tests.benchmarks.smoothed_slopes",
        columns=["law", "h [ms]", "error", "worst scene", "seen from afar", "zeroth order", "first order", "µs"],
        rows=rows,
        note=f"Median error of slopes over {len(SMOOTH_SCENES)} scenes and 17 points each, as a share of the exact"
        f" slope, and the scene where it is largest; slope of `{AFAR}`, where the exact one is 0, as a share of the"
        " exact secant over a tenth of the force; median standard deviation of one sample of the zeroth order"
        " (mirrored) and of the first order over noise of a tenth of the parameter, as a share of the exact slope;"
        " processor time of a rollout with its gradient in `oblique-drop`.",
    )


if __name__ == "__main__":
    main()
