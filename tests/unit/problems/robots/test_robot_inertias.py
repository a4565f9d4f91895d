"""Masses and inertias of robots' files agree with formulas written here and with MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ocp.errors import InputError
from problems import robots
from problems.robots.inertias import check_inertias
from problems.robots.robot import Robot

mujoco = pytest.importorskip("mujoco")

TURNED = """<robot name="turned">
  <link name="base"/>
  <joint name="spin" type="revolute"><parent link="base"/><child link="rotor"/>
    <axis xyz="{axis}"/><limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
  <link name="rotor"><inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="{xy}" ixz="0" iyz="0"/></inertial></link>
  {more}
</robot>"""


def load(folder: Path, name: str, text: str) -> Robot:
    file = folder / name
    file.write_text(text)
    return robots.load(file)


def roll_pitch_yaw(r: float, p: float, y: float) -> np.ndarray:
    """Return the rotation Rz Ry Rx of roll, pitch and yaw, as in the URDF specification."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (r, p, y))
    X = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ Y @ X


@pytest.mark.parametrize("rpy", [(0, 0, np.pi / 2), (0.3, -1.1, 2.5), (np.pi, 0, 0.2)])
@pytest.mark.parametrize("xy", [0.0, 0.05])
def test_an_inertial_frame_that_is_turned(tmp_path: Path, rpy: tuple, xy: float):
    words = " ".join(map(str, rpy))
    text = TURNED.format(axis="1 0 0", xyz="0.1 0 -0.3", rpy=words, xy=xy, more="")
    robot = load(tmp_path, "turned.urdf", text)
    R = roll_pitch_yaw(*rpy)
    wanted = R @ np.array([[0.1, xy, 0], [xy, 0.2, 0], [0, 0, 0.25]]) @ R.T
    body = robot.machine.bodies[0]
    assert body.inertia == pytest.approx(wanted[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], abs=1e-12)
    assert body.com == (0.1, 0, -0.3) and body.mass == 2


def test_links_without_an_inertial_have_no_mass(tmp_path: Path):
    """They have none, as in the URDF specification, and do not matter if fixed to another link."""
    shape = "<collision><geometry><sphere radius='0.1'/></geometry></collision>"
    fixed = f"""<link name="lamp">{shape}</link><joint name="weld" type="fixed">
      <parent link="rotor"/><child link="lamp"/><origin xyz="0 1 0"/></joint>"""
    text = TURNED.format(axis="0 0 1", xyz="0 0 0", rpy="0 0 0", xy=0, more=fixed)
    body = load(tmp_path, "lamp.urdf", text).machine.bodies[0]
    assert body.mass == 2 and body.inertia[:3] == pytest.approx([0.1, 0.2, 0.25], rel=1e-12)
    moving = fixed.replace('"fixed"', '"continuous"')
    robot = load(tmp_path, "hinge.urdf", text.replace(fixed, moving))
    assert robot.machine.bodies[1].mass == pytest.approx(1000 * 4 / 3 * np.pi * 0.1**3)
    assert any("link lamp moves without <inertial>" in note for note in robot.notes)


WAYS = [
    'quat="0.9 0.1 -0.3 0.2"',
    'euler="10 -20 130"',
    'axisangle="1 2 -1 77"',
    'xyaxes="1 1 0 -1 1 1"',
    'zaxis="1 -2 0.5"',
    'zaxis="0 0 -1"',
    'zaxis="0 0 2"',
]
GEOMS = [
    '<geom type="sphere" size="0.1" density="500"/>',
    '<geom type="box" size="0.1 0.2 0.3" quat="0.9 0.1 -0.3 0.2" pos="1 0 0"/>',
    '<geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.05" mass="2"/>',
    '<geom type="cylinder" size="0.1 0.3" euler="30 40 50" pos="0 0 1"/>'
    '<geom type="ellipsoid" size="0.1 0.2 0.3" euler="-30 40 50"/>',
    '<geom type="sphere" size="0.1" mass="0"/><geom type="box" size="0.1 0.1 0.1" group="3"/>',
]


def compiled(inside: str, compiler: str = "") -> tuple[Any, Any]:
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><compiler {compiler}/><worldbody><body name="a" pos="0 0 1" euler="5 6 7">'
        f"<freejoint/>{inside}</body></worldbody></mujoco>"
    )
    for k, geom in enumerate(spec.geoms):
        geom.name = f"geom {k}"
    return spec.compile(), spec


@pytest.mark.parametrize("compiler", ["", 'eulerseq="ZYX"', 'eulerseq="zxz"'])
@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_turn_an_inertial_is_read_as_mujoco_does(way: str, compiler: str):
    own = f'<inertial pos="1 2 3" {way} mass="2" diaginertia="1 2 2.5"/>'
    model, spec = compiled(own, compiler)
    check_inertias(model, spec, None)
    model.body_iquat[1] = [1, 0, 0, 0]
    if "0 0 2" not in way and "0 0 -1" not in way:
        with pytest.raises(ValueError, match=r"body 'a': MuJoCo .* reads another inertia"):
            check_inertias(model, spec, None)


@pytest.mark.parametrize("geoms", [*GEOMS, "".join(GEOMS)])
def test_solids_weigh_what_mujoco_gives_them(geoms: str):
    model, spec = compiled(geoms)
    check_inertias(model, spec, None)
    model.body_inertia[1] *= 1.001
    with pytest.raises(ValueError, match="another inertia than"):
        check_inertias(model, spec, None)


@pytest.mark.parametrize(
    ("field", "what"), [("body_mass", "mass"), ("body_ipos", "centre"), ("body_inertia", "inertia")]
)
def test_every_number_is_compared(field: str, what: str):
    model, spec = compiled('<inertial pos="1 2 3" mass="2" fullinertia="1 2 2.5 0.1 0.2 0.3"/><geom size="1"/>')
    check_inertias(model, spec, None)
    getattr(model, field)[1] *= 1.00001
    with pytest.raises(ValueError, match=f"another {what} than"):
        check_inertias(model, spec, None)


def test_a_reader_that_loses_the_turn_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """MuJoCo up to 3.13 takes the file's moments along the link's axes."""
    compile_file = mujoco.MjSpec.compile

    def forgetful(spec: Any) -> Any:
        model = compile_file(spec)
        model.body_inertia[-1], model.body_iquat[-1] = [0.1, 0.2, 0.25], [1, 0, 0, 0]
        return model

    monkeypatch.setattr(mujoco.MjSpec, "compile", forgetful)
    said = r"body 'rotor': MuJoCo [0-9.]+ reads another inertia than the file, by 0.1; install"
    text = TURNED.format(axis="1 0 0", xyz="0 0 0", rpy=f"0 0 {np.pi / 2}", xy=0, more="")
    with pytest.raises(InputError, match=said):
        load(tmp_path, "turned.urdf", text)


@pytest.mark.parametrize("told", ['boundmass="3"', 'boundinertia="9"'])
def test_files_that_let_mujoco_adjust_masses_are_not_compared(told: str):
    model, spec = compiled('<inertial pos="1 2 3" mass="2" diaginertia="1 2 2.5"/>', told)
    check_inertias(model, spec, None)
