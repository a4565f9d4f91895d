"""Sixty public robot files: which are read, with how many bodies, motors and contacts, or why not.

``python -m tests.benchmarks.robots.public`` reads them and rewrites the site's table. Packages that
are not installed are searched for below the folders of ``EXTRA_ROBOTS``, which hold their unpacked
wheels.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from docs.generator.measured import table, write_table
from ocp.errors import InputError
from problems import robots

COLUMNS = ("package", "file", "bodies", "motors", "contacts", "read, or why not")
FILES = {
    "dm_control": (
        "suite/acrobot.xml suite/ball_in_cup.xml suite/cartpole.xml suite/cheetah.xml"
        " suite/dog.xml suite/finger.xml suite/fish.xml suite/hopper.xml suite/humanoid.xml"
        " suite/manipulator.xml suite/pendulum.xml suite/quadruped.xml suite/reacher.xml"
        " suite/swimmer.xml suite/walker.xml walkers/assets/humanoid_CMU_V2020.xml"
        " boxhead/boxhead.xml kinova/jaco_arm.xml"
    ),
    "gymnasium": (
        "mujoco/assets/ant.xml mujoco/assets/half_cheetah.xml mujoco/assets/hopper.xml"
        " mujoco/assets/humanoid.xml mujoco/assets/inverted_double_pendulum.xml"
        " mujoco/assets/inverted_pendulum.xml mujoco/assets/pusher_v5.xml"
        " mujoco/assets/reacher.xml mujoco/assets/swimmer.xml mujoco/assets/walker2d_v5.xml"
    ),
    "gymnasium_robotics": (
        "adroit_hand/adroit_door.xml adroit_hand/adroit_pen.xml ../assets/hand/reach.xml ../assets/fetch/reach.xml"
    ),
    "metaworld": "../sawyer_xyz/sawyer_reach_v3.xml",
    "safety_gymnasium": "xmls/car.xml xmls/doggo.xml",
    "robosuite": (
        "robots/baxter/robot.xml robots/iiwa/robot.xml robots/panda/robot.xml"
        " robots/sawyer/robot.xml robots/spot/robot.xml robots/ur5e/robot.xml"
        " grippers/robotiq_gripper_140.xml"
    ),
    "example_robot_data": (
        "urdf/a1.urdf anymal_b_simple_description/robots/anymal.urdf urdf/baxter.urdf"
        " robots/bolt.urdf urdf/double_pendulum.urdf urdf/g1_29dof_rev_1_0.urdf"
        " robots/hyq_no_sensors.urdf robots/kinova.urdf urdf/panda.urdf robots/solo12.urdf"
        " robots/talos_reduced.urdf urdf/ur5_robot.urdf urdf/allegro_right_hand.urdf"
    ),
    "pybullet_data": (
        "kuka_iiwa/model.urdf quadruped/minitaur.urdf franka_panda/panda.urdf mini_cheetah/mini_cheetah.urdf r2d2.urdf"
    ),
}
"""Ends of the files' paths by package; those with ``..`` are named by the folder above."""


def find(package: str, path: str) -> Path | None:
    """Return the place of a package's file on this computer, None if it is missing."""
    spec = find_spec(package)
    places = [*(spec.submodule_search_locations or ())] if spec else []
    extra = [Path(place) for place in os.environ.get("EXTRA_ROBOTS", "").split(os.pathsep) if place]
    places += [folder for place in extra for folder in place.rglob(package) if folder.is_dir()]
    places += [place / package for place in extra]
    return next((hit for place in places for hit in sorted(Path(place).rglob(path))), None)


def rows() -> Iterator[list[str | int | None]]:
    """Read file after file, and yield the table's rows."""
    for package, paths in FILES.items():
        for path in paths.split():
            name = path.removeprefix("../")
            file = find(package, name)
            if file is None:
                yield [package, name, None, None, None, "not on this computer"]
                continue
            try:
                wide = file.parent.parent if path.startswith("..") else None
                robot = robots.load(file, folder=wide)
            except InputError as error:
                reason = str(error).partition(": ")[2]
                yield [package, name, None, None, None, f"**refused**: {reason}"]
                continue
            said = "read with `--folder ..`" if wide else "read"
            counts = len(robot.machine.bodies), len(robot.actuators), len(robot.friction)
            yield [package, name, *counts, said]


def main() -> None:
    """Read all files, and store the table."""
    warnings.simplefilter("ignore")
    lines = []
    for row in rows():
        lines.append(row)
        print(table(COLUMNS, [row]).splitlines()[-1], flush=True)
    missing = sum(row[-1] == "not on this computer" for row in lines)
    read = sum(str(row[-1]).startswith("read") for row in lines)
    print(f"{read} of {len(lines)} read, {missing} not on this computer")
    if missing:
        sys.exit("the table is written where all packages are unpacked; see EXTRA_ROBOTS")
    write_table(
        "robot-files",
        title="Public robot files",
        command="python -m tests.benchmarks.robots.public",
        columns=COLUMNS,
        rows=lines,
        note=f"{read} of {len(lines)} files are read; ocp show tells what of them is not used.",
    )


if __name__ == "__main__":
    main()
