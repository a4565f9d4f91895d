"""Texts of robot files as users write them, and what is said of them."""

from __future__ import annotations

from pathlib import Path

from problems import robots
from problems.robots import Robot

SOLID = '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def link(name: str, inside: str = BALL, mass: float = 1.0) -> str:
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{SOLID}</inertial>{inside}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    *,
    inside: str = "",
    kind: str = "prismatic",
    axis: str = "1 0 0",
    limit: str = 'lower="-2" upper="2" effort="10" velocity="3"',
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.1"/><axis xyz="{axis}"/><limit {limit}/>{inside}</joint>'
    )


def urdf(*parts: str) -> str:
    return f"<robot name='stranger'>{''.join(parts)}</robot>"


def mjcf(inside: str, more: str = "") -> str:
    body = f"<body name='b' pos='0 0 0.3'><joint name='j' axis='0 1 0'/>{inside}</body>"
    floor = "<geom name='floor' type='plane' size='0 0 1'/>"
    return f"<mujoco><worldbody>{floor}{body}</worldbody>{more}</mujoco>"


SPHERE = "<geom name='g' size='0.1' pos='0.3 0 0'/>"


def read(tmp_path: Path, text: str, **options: object) -> Robot:
    file = tmp_path / ("robot.urdf" if "<robot" in text else "robot.xml")
    file.write_text(text)
    return robots.load(file, **options)  # type: ignore[arg-type]


def told(robot: Robot) -> str:
    return "\n".join((*robot.ignored, *robot.notes))
