"""Robot files in the commands: shown, written into a problem that solves, or rejected."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from ocp import solve
from problems import load, robots
from problems.drawing import ContactFrame, Segment

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests/data"
HOPPER = ROOT / "examples/hopper.xml"


def test_a_robot_is_shown_with_all_that_was_read_and_what_was_not(ocp) -> None:
    shutil.copy(DATA / "finger.urdf", "finger.urdf")
    done = ocp("show", "finger.urdf")
    assert done.code == 0, done.err
    for words in (
        "  fore",
        "shoulder",
        "-1 to 1",
        "tip geom 1 on ground",
        "Home: upper 0, fore 0.",
        "- velocity of limit of joints",
    ):
        assert words in done.out, words
    found = ocp("show", "finger.urdf", "--json").json
    assert [link["parent"] for link in found["links"]] == [None, "upper"]
    assert [link["mass"] for link in found["links"]] == pytest.approx([1, 0.9])
    assert [motor["gear"] for motor in found["motors"]] == [30, 12]
    assert [one["name"] for one in found["contacts"]] == ["tip geom 1 on ground"]
    assert len(found["ignored"]) == 3


J, G = "<joint name='j' axis='0 1 0'/>", "<geom name='g' size='.1'/>"


def test_a_robot_floats_when_asked(ocp) -> None:
    heavy = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    text = (DATA / "finger.urdf").read_text()
    base = f'<link name="base"><inertial>{heavy}</inertial></link>'
    Path("finger.urdf").write_text(text.replace('<link name="base"/>', base))
    line = "The root is fixed; --floating makes it free."
    assert line in ocp("show", "finger.urdf").out
    shown = ocp("show", "finger.urdf", "--floating")
    assert shown.code == 0 and line not in shown.out and "base_x 0, base_y 0" in shown.out
    assert ocp("new", "fly", "--robot", "finger.urdf", "--floating").code == 0
    assert '"finger.urdf", floating=True)' in Path("fly.py").read_text()
    problem = load("fly.py").problem({"N": 3})
    assert problem.initial_states(problem.parameters.values)[0].shape == (17,)
    shown = ocp("show", "finger.urdf", "--planar")
    assert shown.code == 0 and line not in shown.out and "base x 0, base z 0, base 0" in shown.out
    assert ocp("new", "slide", "--robot", "finger.urdf", "--planar").code == 0
    assert '"finger.urdf", planar=True)' in Path("slide.py").read_text()
    done = ocp("show", "finger.urdf", "--planar", "--floating")
    assert done.code == 2 and "exclude each other; give one of them" in done.err
    done = ocp("show", str(HOPPER), "--floating")
    assert done.code == 2 and "in MJCF <freejoint/> makes a body float" in done.err
    assert done.err.startswith(f"error: {HOPPER}: no root to free")


FILES = {
    "hopper": HOPPER,
    "arm": DATA / "arm.xml",
    "leg": DATA / "leg.urdf",
    "crane": DATA / "crane.xml",
    "servos": DATA / "servos.xml",
}


@pytest.mark.cheap_cases("arm")
@pytest.mark.parametrize("name", FILES)
def test_a_problem_of_a_robot_loads_and_is_drawn(ocp, name: str) -> None:
    Path("files").mkdir()
    file = shutil.copy(FILES[name], Path("files"))
    done = ocp("new", "my-robot", "--robot", str(file), "--json")
    assert done.code == 0 and done.json["template"] == "robot", done.err
    text = Path("my-robot.py").read_text()
    assert f'Path(__file__).parent / "files/{FILES[name].name}"' in text
    found = load("my-robot.py")
    problem = found.problem({"N": 3})
    assert problem.name == "my-robot" and found.draw is not None and found.frames is not None
    x0 = problem.initial_states(problem.parameters.values)[0]
    shapes = found.draw(found.params({}), x0)
    assert any(isinstance(shape, Segment) for shape in shapes)
    frames = found.frames(found.params({}), x0)
    assert frames and all(isinstance(frame, ContactFrame) for frame in frames)
    before = found.digest
    Path(file).write_text(FILES[name].read_text() + "<!-- edited -->")
    assert load("my-robot.py").digest != before, "the robot is part of what a run was made of"


@pytest.mark.costly_cases("hopper")
@pytest.mark.parametrize("name", ["hopper", "arm"])
def test_a_problem_of_a_robot_solves(ocp, name: str) -> None:
    assert ocp("new", "go", "--robot", str(FILES[name])).code == 0
    found = solve(load("go.py").problem(), contact="exact")
    assert found.success and found.certificate.stationarity == "B"
    x = found.data["x"].sel(scenario=0).values
    way = (x[-1] - x[0])[: 1 if name == "hopper" else 2]
    assert way == pytest.approx([0.2] * len(way), abs=0.02)


def test_without_mujoco_the_sentence_says_what_to_install(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    done = ocp("show", str(HOPPER))
    assert done.code == 2
    assert done.err == ("error: reading robot files needs the package mujoco; install 'centralpath[robots]'\n")


def mjcf(inside: str, more: str = "") -> str:
    return f"<mujoco>{more}<worldbody><body name='a'>{inside}</body></worldbody></mujoco>"


URDF = (DATA / "leg.urdf").read_text()
BAD = {
    "no XML": ("hello", "is no XML"),
    "another program's": ("<world/>", "neither a URDF"),
    "xacro": ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:if/></robot>', "xacro"),
    "a document type": ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "document type"),
    "deep": ("<mujoco>" + "<body>" * 300 + "</body>" * 300 + "</mujoco>", "deeper than 100"),
    "empty": ("<mujoco/>", "no joint; expected a robot"),
    "no mass": (mjcf(J), "must be larger than mjMINVAL in 'a'"),
    "negative mass": (mjcf(J + "<geom size='.1' mass='-1'/>"), "negative"),
    "negative inertia": (mjcf(J + "<inertial pos='0 0 0' mass='1' diaginertia='-1 -1 -1'/>"), "inertia"),
    "not finite": (mjcf("<joint pos='nan 0 0'/>" + G), "is not finite"),
    "too large": (mjcf(J + "<geom size='1e200'/>"), "too large to compute with"),
    "twice": (mjcf(f"{J}{G}<body name='a'>{J}{G}</body>"), "repeated name 'a' in body"),
    "unknown attribute": (mjcf(f"{J}<geom bogus='1' size='.1'/>"), "'bogus'"),
    "two motors": (mjcf(J + G, "<actuator><motor joint='j'/><motor joint='j'/></actuator>"), "two motors"),
    "many joints": (
        "<mujoco><worldbody>" + "<body><joint axis='0 1 0'/><geom size='.1'/></body>" * 200 + "</worldbody></mujoco>",
        "200 joints; at most 100",
    ),
    "uneven tree": (URDF.replace('<child link="leg"/>', '<child link="torso"/>'), "not a robot that compiles"),
    "mimic": (URDF.replace("<axis", '<mimic joint="none"/><axis'), "which is no other joint"),
    "plugin": (mjcf(J + G, "<extension><plugin plugin='p'/></extension>"), "<extension> is not read"),
    "copies": (mjcf(f"{J}<replicate count='9999999'>{G}</replicate>"), "<replicate> is not read"),
    "include above": (mjcf(J + G, "<include file='../secret.xml'/>"), "outside the robot's folder"),
    "include absolute": (mjcf(J + G, "<include file='/etc/passwd'/>"), "outside the robot's folder"),
    "include by a link": (mjcf(J + G, "<include file='link.xml'/>"), "outside the robot's folder"),
    "include missing": (mjcf(J + G, "<include file='none.xml'/>"), "is not in its folder"),
    "include itself": (mjcf(J + G, "<include file='robot.xml'/>"), "included twice"),
    "include in URDF": (URDF.replace('<link name="world"/>', "<include file='robot.xml'/>"), "<include> is not read"),
    "mesh folder": (mjcf(J + G, "<compiler meshdir='/etc'/>"), "outside the robot's folder"),
    "mesh above": (mjcf(J + G, "<asset><mesh file='a/../../b.stl'/></asset>"), "outside the robot's folder"),
    "mesh missing": (mjcf(J + G, "<asset><mesh file='b.stl'/></asset>"), "is not in its folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_in_one_sentence(ocp, case: str) -> None:
    text, told = BAD[case]
    Path("outside.xml").write_text("<mujoco/>")
    Path("robot").mkdir()
    Path("robot/link.xml").symlink_to(Path("outside.xml").resolve())
    Path("robot/robot.xml").write_text(text)
    done = ocp("show", "robot/robot.xml")
    assert done.code == 2 and done.out == "", done.out
    assert done.err.startswith("error: robot/robot.xml: ") and told in done.err, done.err
    assert done.err.count("\n") == 1
    assert ocp("new", "mine", "--robot", "robot/robot.xml").code == 2
    assert sorted(map(str, Path().iterdir())) == ["outside.xml", "robot"], "nothing was written"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["show", "none.urdf"], "none.urdf: there is no such file"),
        (["show", "folder.xml"], "folder.xml: is not a regular file"),
        (["show", "bytes.xml"], "bytes.xml: is not a text in UTF-8"),
        (["solve", "bytes.xml"], "ocp new NAME --robot FILE"),
        (["new", "mine", "--robot", "none.urdf"], "none.urdf: there is no such file"),
        (["new", "mine", "--scene", "--robot", "none.urdf"], "--scene and --robot are two kinds"),
    ],
)
def test_a_bad_request_is_refused(ocp, words: list[str], told: str) -> None:
    Path("folder.xml").mkdir()
    Path("bytes.xml").write_bytes(b"\xff\xfe<\x00")
    done = ocp(*words)
    assert done.code == 2 and told in done.err


def test_a_hostile_file_opens_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only this package reads files, all in the folder; MuJoCo gets texts and bytes."""
    seen: list[Path] = []
    original = Path.read_bytes

    def read_bytes(self: Path) -> bytes:
        seen.append(self.resolve())
        return original(self)

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    (tmp_path / "in").mkdir()
    (tmp_path / "in/part.xml").write_text(f"<x><body name='b' pos='0 0 1'>{J}{G}</body></x>")
    (tmp_path / "robot.xml").write_text("<mujoco><worldbody><include file='in/part.xml'/></worldbody></mujoco>")
    robot = robots.load(tmp_path / "robot.xml")
    assert [link.name for link in robot.machine.bodies] == ["b"]
    assert seen == [tmp_path / "robot.xml", tmp_path / "in/part.xml"]
    # Neither pictures nor meshes outside a URDF's folder are opened.
    (tmp_path / "robot.xml").write_text(mjcf(J + G, "<asset><texture name='t' file='/dev/zero'/></asset>"))
    assert "texture: change only pictures" in robots.load(tmp_path / "robot.xml").ignored
    (tmp_path / "robot.urdf").write_text(URDF.replace('<sphere radius="0.04"/>', "<mesh filename='/etc/passwd'/>"))
    assert any("mesh of link" in told for told in robots.load(tmp_path / "robot.urdf").ignored)
    assert not any(file.is_relative_to("/etc") or file == Path("/dev/zero") for file in seen)


def test_a_mesh_gives_inertia_and_a_hull(tmp_path: Path) -> None:
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(1, 3, 2), (1, 2, 4), (2, 3, 4), (1, 4, 3)]
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/corner.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces)
    )
    (tmp_path / "robot.xml").write_text(
        mjcf(
            J + "<geom type='mesh' mesh='corner' name='m'/>",
            "<compiler meshdir='meshes'/><asset><mesh file='corner.obj'/></asset>",
        ).replace("<worldbody>", "<worldbody><geom type='plane' size='0 0 1'/>")
    )
    robot = robots.load(tmp_path / "robot.xml")
    assert float(robot.machine.bodies[0].mass) == pytest.approx(1000 / 6)
    assert [*robot.friction] == [f"m on world geom 1 {k}" for k in (1, 2, 3, 4)]
