"""Robot files as users write them: what is read, reported, and rejected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp.errors import InputError
from problems import robots
from problems.robots.elements import ALL, MJCF, URDF
from tests.golden.cases.robot_texts import BALL, SPHERE, joint, link, mjcf, read, told, urdf

# Friction


SLIDER = urdf(
    link("rail", ""),
    link("puck", "{}" + BALL),
    joint("along", "rail", "puck"),
    joint("up", "puck", "tip", axis="0 0 1"),
    link("tip"),
    "{}",
)


@pytest.mark.parametrize(
    ("inside", "more", "expected"),
    [
        ('<contact><lateral_friction value="0.07"/></contact>', "", 0.07),
        ("", '<gazebo reference="puck"><mu1>0.2</mu1><mu2>0.2</mu2></gazebo>', 0.2),
        ("", '<gazebo reference="puck"><mu1 value="1.8"/></gazebo>', 1.8),
        ("<contact><mu value='0'/></contact>", "", 0.0),
        ("", "", 1.0),
    ],
)
def test_friction_of_a_link_is_that_of_its_contacts(tmp_path: Path, inside: str, more: str, expected: float) -> None:
    robot = read(tmp_path, SLIDER.format(inside, more), floating=True)
    assert robot.friction["puck geom 1 on ground"] == pytest.approx(expected)
    assert robot.friction["tip geom 1 on ground"] == 1


def test_of_two_links_with_friction_the_smaller_counts(tmp_path: Path) -> None:
    low, high = (f'<contact><lateral_friction value="{f}"/></contact>' for f in (0.3, 0.6))
    base = link("base", low + BALL)
    arm = link("arm", "", 0.5)
    robot = read(
        tmp_path,
        urdf(
            base,
            arm,
            link("hand", high + BALL),
            joint("a", "base", "arm"),
            joint("b", "arm", "hand"),
        ),
        floating=True,
    )
    assert robot.friction["base geom 1 on hand geom 1"] == pytest.approx(0.3)
    assert robot.friction["hand geom 1 on ground"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    "text",
    [
        SLIDER.format("", '<gazebo reference="puck"><mu1>0.9</mu1><mu2>0.1</mu2></gazebo>'),
        SLIDER.format("<contact><mu>0.4</mu><mu2>0.5</mu2></contact>", ""),
        mjcf(SPHERE, "<contact><pair geom1='g' geom2='floor' friction='1 0.2'/></contact>"),
    ],
)
def test_friction_that_depends_on_the_direction_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="the same in all directions, so give one number"):
        read(tmp_path, text)


def test_of_two_statements_about_a_link_the_smaller_is_used(tmp_path: Path) -> None:
    twice = '<contact><lateral_friction value="0.9"/></contact>'
    other = '<gazebo reference="puck"><mu1>0.4</mu1></gazebo>'
    robot = read(tmp_path, SLIDER.format(twice, other), floating=True)
    assert robot.friction["puck geom 1 on ground"] == pytest.approx(0.4)
    assert "friction 0.9 of link puck: the smaller 0.4 is used" in told(robot)


def test_friction_of_a_pair_of_geoms_is_used(tmp_path: Path) -> None:
    soft = "friction='0.3 0.3' margin='0.1' solref='0.1 1'"
    pair = f"<contact><pair geom1='g' geom2='floor' {soft}/></contact>"
    robot = read(tmp_path, mjcf(SPHERE.replace("/>", " friction='2'/>"), pair))
    assert [*robot.friction.values()] == [pytest.approx(0.3)]
    assert "margin of pair" in told(robot) and "solref of pair" in told(robot)
    assert "contact is rigid" in told(robot)


# Features that are not read are reported by name


def test_a_safety_controller_and_the_rest_of_contact_are_named(tmp_path: Path) -> None:
    guard = '<safety_controller soft_lower_limit="-1" k_velocity="10"/>'
    soft = "<contact><rolling_friction value='0.1'/><contact_cfm value='0'/></contact>"
    robot = read(
        tmp_path,
        urdf(
            link("base"),
            link("arm", soft + BALL),
            joint("a", "base", "arm", inside=guard),
            '<transmission name="t"><type>simple</type></transmission>',
            "<odd name='x' y='1'/>",
            '<gazebo reference="arm"><kp>1e5</kp></gazebo>',
        ),
    )
    for words in (
        "safety_controller of joint a: its soft limits and gains act in another program",
        "contact of link arm (rolling_friction, contact_cfm): contact is rigid",
        "transmission t (type): each joint has its own motor",
        "odd x: not read",
        "gazebo arm (kp): settings of another program",
        "velocity of limit of joint a: speeds",
    ):
        assert words in told(robot), told(robot)


NOT_READ = {
    "geom": {"solimp": "0.9 0.95 0.001", "margin": "0.01", "gap": "0.005", "solmix": "2"},
    "joint": {"frictionloss": "0.1", "solreflimit": "0.1 1", "margin": "0.2"},
    "body": {"gravcomp": "1"},
}


@pytest.mark.parametrize(("tag", "name"), [(t, a) for t, row in NOT_READ.items() for a in row])
def test_attributes_that_are_not_read_are_named(tmp_path: Path, tag: str, name: str) -> None:
    text = mjcf(SPHERE)
    where = {"geom": "<geom name='g'", "joint": "<joint name='j'", "body": "<body name='b'"}[tag]
    robot = read(tmp_path, text.replace(where, f"{where} {name}='{NOT_READ[tag][name]}'"))
    own = {"geom": "g", "joint": "j", "body": "b"}[tag]
    assert f"{name} of {tag} {own}:" in told(robot)
    default = f"<default><{tag} {name}='{NOT_READ[tag][name]}'/></default>"
    if tag != "body":
        robot = read(tmp_path, text.replace("<mujoco>", f"<mujoco>{default}"))
        assert f"{name} of {tag} of default main:" in told(robot)


def test_all_that_the_tables_name_is_read_without_a_word(tmp_path: Path) -> None:
    robot = read(tmp_path, mjcf(SPHERE, "<actuator><motor name='m' joint='j' gear='3'/></actuator>"))
    assert not robot.ignored
    assert MJCF["weld"] == [ALL] and "effort" in URDF["limit"]
    assert "velocity" not in URDF["limit"] and "solref" not in MJCF["geom"]


# Dialects


@pytest.mark.parametrize("declared", [True, False])
def test_a_world_that_no_link_declares_is_the_world(tmp_path: Path, declared: bool) -> None:
    world = '<link name="world"/>' if declared else ""
    robot = read(tmp_path, urdf(link("arm"), joint("pin", "world", "arm"), world))
    assert [body.name for body in robot.machine.bodies] == ["arm"]
    with pytest.raises(InputError, match="not a robot that compiles"):
        read(tmp_path, urdf(link("arm"), joint("pin", "wall", "arm")))


def test_prefixes_that_nothing_declares_are_named_and_skipped(tmp_path: Path) -> None:
    soft = BALL.replace("</coll", "<lab:soft><lab:mu value='0.4'/></lab:soft></coll")
    text = urdf(link("ball", soft), "<lab:filter name='f'/>").replace("<robot", "<robot lab:v='2'")
    robot = read(tmp_path, text)
    assert "lab:soft of link ball (lab:mu): an extension of another program" in told(robot)
    assert "lab:filter f: an extension of another program" in told(robot)
    assert "lab:v of robot stranger" in told(robot)
    # Without a joint its root floats.
    assert robot.floats and "Without a joint its root is free." in robot.notes
    spaced = read(tmp_path, f"\n <!-- by hand -->\n<?xml version='1.0'?>{text}")
    assert spaced.ignored == robot.ignored


@pytest.mark.parametrize(
    ("limit", "kind", "limits", "motors"),
    [
        ('lower="-inf" upper="inf" effort="inf" velocity="inf"', "revolute", None, 0),
        ('lower="-1" upper="1" effort="Infinity" velocity="1"', "revolute", (-1, 1), 0),
        ('lower="-1e16" upper="1e16" effort="4" velocity="1"', "revolute", (-1e16, 1e16), 1),
        ('effort="4" velocity="inf"', "continuous", None, 1),
    ],
)
def test_infinite_limits_are_no_limits(
    tmp_path: Path, limit: str, kind: str, limits: tuple[float, float] | None, motors: int
) -> None:
    text = urdf(link("base"), link("arm"), joint("a", "base", "arm", kind=kind, limit=limit))
    robot = read(tmp_path, text)
    assert robot.machine.bodies[0].limits == limits and len(robot.actuators) == motors
    assert ("effort of joint a: it is infinite" in told(robot)) == (motors == 0)


def test_one_infinite_limit_is_refused(tmp_path: Path) -> None:
    limit = 'lower="0" upper="inf" effort="1" velocity="1"'
    with pytest.raises(InputError, match="'a' has one infinite limit; give a number"):
        read(tmp_path, urdf(link("base"), link("arm"), joint("a", "base", "arm", limit=limit)))


@pytest.mark.parametrize("root", ["<sdf version='1.7'><model name='m'/></sdf>", "<sdf/>"])
def test_sdf_gets_one_sentence(tmp_path: Path, root: str) -> None:
    for name in ("box.sdf", "box.urdf"):
        (tmp_path / name).write_text(root)
        with pytest.raises(InputError, match=r"SDF, the language of Gazebo, .* convert it to URDF"):
            robots.load(tmp_path / name)


def tetrahedron(file: Path, size: float = 0.1) -> None:
    """Write an OBJ file of a tetrahedron."""
    file.parent.mkdir(parents=True, exist_ok=True)
    corners = size * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 1 4 3"]
    file.write_text("\n".join(lines))


MESH = "<collision><geometry><mesh filename='{}'/></geometry></collision>"


@pytest.mark.parametrize(
    "name", ["package://kit/meshes/foot.obj", "../meshes/foot.obj", "file:///else/meshes/foot.obj"]
)
def test_meshes_out_of_the_folder_are_named_and_read_from_a_wider_one(tmp_path: Path, name: str) -> None:
    tetrahedron(tmp_path / "kit/meshes/foot.obj")
    file = tmp_path / "kit/urdf/leg.urdf"
    file.parent.mkdir()
    file.write_text(
        urdf(
            link("base", ""),
            link("foot", MESH.format(name)),
            joint("lift", "base", "foot", axis="0 0 1"),
        )
    )
    robot = robots.load(file)
    assert "mesh of link foot: no STL, OBJ or MSH file in the robot's folder" in told(robot)
    assert not robot.friction
    if not name.startswith("file"):
        wide = robots.load(file, folder=tmp_path / "kit")
        assert wide.friction and "mesh of link foot" not in told(wide)


def test_a_folder_of_meshes_outside_says_how_to_go_on(tmp_path: Path) -> None:
    tetrahedron(tmp_path / "meshes/foot.obj")
    file = tmp_path / "models/hand.xml"
    file.parent.mkdir()
    mesh = "<compiler meshdir='../meshes'/><asset><mesh name='m' file='foot.obj'/></asset>"
    file.write_text(mjcf("<geom type='mesh' mesh='m'/>", mesh))
    with pytest.raises(InputError, match=r"outside the robot's folder; name a folder .* --folder DIR"):
        robots.load(file)
    robot = robots.load(file, folder=tmp_path)
    assert float(robot.mass) == pytest.approx(1000 * 1e-3 / 6)
    with pytest.raises(InputError, match="outside the robot's folder"):
        robots.load(file, folder=tmp_path / "models")
