"""Published robots and the named quadruped, from their files to certified plans.

``python -m tests.benchmarks.robots.plans`` runs the commands of a new user and rewrites the table.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

from docs.generator.measured import write_table
from tests.benchmarks.robots.equations import File

ROBOTS = (
    File("gymnasium", "mujoco/assets/pusher_v5.xml"),
    File("dm_control", "suite/cheetah.xml"),
    File("example_robot_data", "ur_description/urdf/ur5_robot.urdf"),
)
QUADRUPED = {
    "trot": (),
    "stand up, w_v = 0.02": ("-p", "start=lie", "-p", "distance=0", "-p", "w_v=0.02"),
}
LAWS = {"exact": ("--contact", "exact"), "barrier 1e-3": ("--contact", "barrier", "-c", "mu=1e-3")}
FLOOR_S = 60.0
COLUMNS = ("plan", "law", "certificate", "cost", "survives", "seconds")
Row = tuple[str, str, str, float, str, str]


def ocp(folder: Path, *words: str) -> str:
    """Run a command and return its stdout; raise if it fails other than by its verdict."""
    found = subprocess.run([sys.executable, "-m", "ocp", *words], cwd=folder, capture_output=True, text=True)
    if found.returncode not in (0, 3):
        raise RuntimeError(found.stderr)
    return found.stdout


def solved(folder: Path, plan: str, law: str, floor: float | None, *words: str) -> Row:
    """Solve cold in wall time, and return the table's row."""
    start = time.perf_counter()
    document = json.loads(ocp(folder, "solve", *words, *LAWS[law], "--json"))
    seconds = time.perf_counter() - start
    survives = {True: "yes", False: "no"}[bool(document["survives"])]
    if document["survives_at_h"] and not document["survives"]:
        survives = "at this step"
    late = floor is not None and (seconds > floor or not document["success"])
    kind = document["stationarity"] if document["success"] else "none"
    told = f"**{seconds:.0f} missed**" if late else f"{seconds:.0f}"
    row = plan, law, kind, float(document["cost"]), survives, told
    print(*row, flush=True)
    return row


def _folders(at: str, names: list[str]) -> list[str]:
    """Return the folders next to a robot that its file does not include."""
    return [name for name in names if Path(at, name).is_dir() and name != "common"]


def main() -> None:
    """Write the table."""
    rows: list[Row] = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for file in ROBOTS:
            path = file.find()
            if path is None:
                print(f"not installed here: {file.path}")
                continue
            place = folder / path.stem
            copytree(path.parent, place, ignore=_folders)
            ocp(place, "show", path.name)
            ocp(place, "new", "goes", "--robot", path.name)
            plan = f"{path.name}, {file.source}"
            rows.append(solved(place, plan, "exact", None, "goes.py"))
            ocp(place, "animate", "@last", "-o", "goes.gif")
        for task, given in QUADRUPED.items():
            plan, words = f"quadruped, {task}", ("quadruped", *given)
            rows += [solved(folder, plan, law, FLOOR_S, *words) for law in LAWS]
    note = "Cold, by the clock, with importing; B or KKT certify, and none is no certificate."
    write_table(
        "robots-planned", title="Plans of robots", command="make bench-robots", columns=COLUMNS, rows=rows, note=note
    )


if __name__ == "__main__":
    main()
