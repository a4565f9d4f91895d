"""Verdicts on the gradients of simulators in every scene, with the ratio of slope and exact slope.

``python -m tests.benchmarks.gradients`` measures all and rewrites the site's table; with ``two-balls`` it measures that
scene alone.
"""

from __future__ import annotations

import sys
from typing import Any

from docs.generator.measured import DATA, read, write_table
from ocp.jobs.gradients import measure_worlds
from problems.gradient_scenes import SCENES
from problems.gradient_scenes.worlds import scene_world

TABLE = "gradient-worlds"
WORLDS = ("exact", "barrier", "penalty", "mujoco", "adaptive", "randomized")


def cell(row: dict[str, Any]) -> str:
    """Return the verdict of a simulator and, where it is not right, the ratio of slope and exact slope."""
    verdict, truth = row["verdict"].replace("-", " "), row["truth"]
    return (
        verdict
        if row["verdict"] in ("right", "zero", "undefined") or not truth
        else (f"{verdict} (×{row['slope'] / truth:.3g})")
    )


def factor(verdict: str) -> str:
    """Return a cell of the README: the multiple of the exact slope alone, with an arrow where slopes explode."""
    ratio = verdict.rpartition("(")[2].removesuffix(")") + " ↑" * verdict.startswith("exploding")
    return {"right": "**right**", "zero": "0", "undefined": "jump"}.get(verdict, ratio)


def main() -> None:
    """Measure scene after scene, and store each row when it is ready."""
    rows = {row[0]: row for row in read(TABLE)["rows"]} if (DATA / f"{TABLE}.json").exists() else {}
    for name in sys.argv[1:] or SCENES:
        scene = SCENES[name]
        report = measure_worlds([scene_world(scene, world) for world in WORLDS], scene.question)
        rows[name] = [name, *map(cell, report.rows)]
        print(*rows[name], sep=" | ", flush=True)
        write_table(
            TABLE,
            title="Which gradient can I trust?",
            command="python -m tests.benchmarks.gradients",
            columns=["scene", *WORLDS],
            rows=[rows[each] for each in SCENES if each in rows],
            note="Verdicts at the settings of `ocp gradients`, and the slope as a multiple of the exact slope."
            " Derivatives are those of the implicit function theorem in our laws, of AD in penalty contacts, and"
            " products of `mjd_transitionFD` in MuJoCo.",
        )


if __name__ == "__main__":
    main()
