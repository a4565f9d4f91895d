"""Robot files as users write them: what is read, reported, and rejected."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems.parameters import ParameterTable
from dynamics.systems.space import Tree
from ocp.errors import InputError
from ocp.simulators.mjcf import write_mjcf as mjcf_of
from problems import robots
from problems.robots import Robot, geoms
from problems.robots.elements import ALL, MJCF, URDF

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


# Joints that move together


GRIPPER = urdf(
    link("palm", ""),
    link("left", "", 0.3),
    link("right", "", 0.2),
    joint("l", "palm", "left", axis="0 1 0"),
    joint("r", "palm", "right", axis="0 -1 0", inside='<mimic joint="l" multiplier="2" offset="0.1"/>'),
)
COUPLED = """<mujoco><option gravity="0 0 0"/>
  <default><geom size=".1" contype="0" conaffinity="0"/></default><worldbody>
  <body name="left"><joint name="l" type="slide" axis="0 1 0" range="-9 9"/>
    <geom mass="0.3"/></body>
  <body name="right"><joint name="r" type="slide" axis="0 -1 0"/><geom mass="0.2"/></body>
  </worldbody>{}<actuator><motor joint="l" gear="10"/></actuator></mujoco>"""


def tied(equality: str) -> str:
    return f"<equality>{equality}</equality>"


def step_once(robot: Robot, u: float, h: float = 0.01) -> np.ndarray:
    """Return the state after one step of the exact law, from rest in the home pose."""

    system = robot.machine.system("r", ParameterTable(()), h=h, friction=None)
    x = np.concatenate([robot.home, np.zeros(system.nx - len(robot.home))])
    x_next, _, _, error = Exact().close(system).solve(x, [u], [])
    assert float(np.array(error).max()) < 1e-9
    return np.array(x_next).ravel()


@pytest.mark.parametrize(
    "text",
    [
        GRIPPER,
        COUPLED.format(tied("<joint joint1='r' joint2='l' polycoef='0.1 2 0 0 0'/>")),
        COUPLED.format(
            "<tendon><fixed name='f'><joint joint='r' coef='1'/></fixed><fixed name='g'>"
            "<joint joint='l' coef='-1'/></fixed></tendon>"
            + tied("<tendon tendon1='f' tendon2='g' polycoef='0.1 -2 0 0 0'/>")
        ),
    ],
)
def test_a_joint_that_follows_moves_its_mass_by_its_ratio(tmp_path: Path, text: str) -> None:
    """``(m1 + 2² m2) dv = h F`` in closed form, and r = 2 l + 0.1 after every step."""
    robot = read(tmp_path, text)
    assert "Joint right follows: right = 2 left + 0.1." in robot.notes
    assert len(robot.actuators) == 1, "what follows has no motor of its own"
    np.testing.assert_allclose(robot.home, [0, 0.1])
    left, right, v_left, v_right = step_once(robot, 1.0)
    assert v_left == pytest.approx(0.01 * 10 / (0.3 + 4 * 0.2), rel=1e-9)
    assert v_right == pytest.approx(2 * v_left) and right == pytest.approx(2 * left + 0.1)
    goal = np.array(ca.evalf(robot.displaced(robot.home, 0.2))).ravel()
    assert goal[1] == pytest.approx(2 * goal[0] + 0.1)


def test_mujoco_is_not_asked_about_joints_that_follow(tmp_path: Path) -> None:
    robot = read(tmp_path, GRIPPER)
    system = robot.machine.system("r", ParameterTable(()), h=0.01, friction=None)
    assert system.machine is not None
    with pytest.raises(InputError, match="joints that follow others"):
        mjcf_of(system.machine, float, {})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GRIPPER.replace('joint="l" mul', 'joint="x" mul'), "which is no other joint; delete its"),
        (GRIPPER.replace('multiplier="2"', 'multiplier="two"'), "expected numbers"),
        (
            COUPLED.format(tied("<connect body1='left' body2='right' anchor='0 0 0'/>")),
            r"<connect> .* closes a loop",
        ),
        (COUPLED.format(tied("<weld body1='left' body2='right'/>")), "<weld> .* closes a loop"),
        (
            COUPLED.format(tied("<joint joint1='r' joint2='l' polycoef='0 1 3 0 0'/>")),
            "is not linear",
        ),
        (
            COUPLED.format("<equality><joint joint1='r' joint2='l'/><joint joint1='l' joint2='r'/></equality>"),
            "contradict or repeat each other",
        ),
        (
            urdf(link("a"), link("b"), joint("j", "a", "b"), "<loop_joint name='k'/>"),
            "<loop_joint> is not read, as it closes a loop",
        ),
    ],
)
def test_loops_are_refused_in_a_sentence(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_an_inactive_loop_is_named(tmp_path: Path) -> None:
    weld = tied("<weld name='w' active='false' body1='left' body2='right'/>")
    robot = read(tmp_path, COUPLED.format(weld))
    assert "equality constraint w: it is inactive" in told(robot)


# Actuators


FLYER = """<mujoco><worldbody><body name="b" pos="0 0 1"><freejoint/><geom size=".1" mass="1"/>
  <site name="s"/><site name="t" pos=".1 0 0"/></body>
  <body name="c" pos="2 0 1"><joint name="j" axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body>
  </worldbody><tendon><fixed name="f"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator>{}</actuator></mujoco>"""


@pytest.mark.parametrize(
    "actuators",
    [
        '<motor name="x" site="s" gear="0 0 1 0 0 .1"/><motor name="y" site="t" gear="0 0 1"/>',
        '<adhesion name="x" body="c" ctrlrange="0 1" gain="2"/><motor name="y" tendon="f"/>',
        '<general name="x" site="s" refsite="t" gear="1 0 0 0 0 0"/><motor name="y" site="t"/>',
    ],
)
def test_actuators_of_sites_bodies_and_tendons_are_named(tmp_path: Path, actuators: str) -> None:
    robot = read(tmp_path, FLYER.format('<motor name="m" joint="j"/>' + actuators))
    assert "actuators x, y: only motors and position servos of hinges and slides" in told(robot)
    assert [actuator.name for actuator in robot.actuators] == ["m"]
    alone = read(tmp_path, FLYER.format(actuators))
    assert alone.controls.shape == (0, 2)


@pytest.mark.parametrize("swapped", [False, True])
def test_a_velocity_servo_beside_a_position_servo_damps(tmp_path: Path, swapped: bool) -> None:
    pair = ['<position name="p" joint="j" kp="40"/>', '<velocity name="d" joint="j" kv="3"/>']
    robot = read(tmp_path, mjcf(SPHERE, f"<actuator>{''.join(pair[:: -1 if swapped else 1])}</actuator>"))
    (body,) = robot.machine.bodies
    assert (body.servo, body.damping, body.gear) == (40, 3, None)
    assert "The input of actuator d is 0: its kv is part of the damping." in robot.notes
    with pytest.raises(InputError, match="'j' has two motors, m and n; give it one"):
        read(
            tmp_path,
            mjcf(
                SPHERE,
                '<actuator><motor name="m" joint="j"/><motor name="n" joint="j"/></actuator>',
            ),
        )


@pytest.mark.parametrize(
    "text",
    [
        mjcf(SPHERE, "<actuator><motor joint='j' gear='1e308'/></actuator>"),
        mjcf(SPHERE, "<actuator><position joint='j' kp='-1e300'/></actuator>"),
        mjcf(SPHERE.replace("0.1", "1e155")),
        urdf(link("a"), link("b", mass=1e200), joint("j", "a", "b")),
    ],
)
def test_numbers_that_overflow_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="too large to compute with; give numbers below"):
        read(tmp_path, text)


# Limits before work


def chain(count: int) -> str:
    body = "<body pos='0 0 1'><joint axis='0 1 0'/><geom size='.1'/>"
    return f"<mujoco><worldbody>{body * count}{'</body>' * count}</worldbody></mujoco>"


LARGE = {
    "joints": (
        "<mujoco><worldbody>" + "<body><joint/></body>" * 60_000 + "</worldbody></mujoco>",
        "60000 joints; at most 100",
    ),
    "joints of URDF": (
        urdf(*["<joint name='j' type='continuous'/>"] * 40_000),
        "40000 joints; at most 100",
    ),
    "geoms": (mjcf("<geom size='.1'/>" * 10_000), "10001 geoms; at most"),
    "attributes": (
        mjcf("<geom " + " ".join(f"a{k}='1'" for k in range(400_000)) + "/>"),
        "larger than 2 MB",
    ),
    "fewer attributes": (
        mjcf("<geom " + " ".join(f"a{k}='1'" for k in range(50_000)) + "/>"),
        "<geom> has 50000 attributes",
    ),
    "pairs": (
        mjcf("<geom size='.1'/>" * 101).replace(
            "</worldbody>", "<body><freejoint/>" + "<geom size='.1'/>" * 101 + "</body></worldbody>"
        ),
        "pairs of geoms may touch",
    ),
    "levels": (chain(99), "nested deeper than 100"),
}


@pytest.mark.parametrize("case", LARGE)
def test_files_that_are_too_large_are_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    text, words = LARGE[case]
    if case != "pairs":
        monkeypatch.setattr(import_module("mujoco").MjSpec, "from_string", None)
    monkeypatch.setattr(geoms, "contacts_between", None)
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


@pytest.mark.costly
def test_a_long_chain_builds_each_contact_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """4005 pairs took 50 s when each of them computed the poses of all bodies."""
    counts = {"between": 0, "pose": 0}
    between, pose = geoms.contacts_between, Tree.pose

    def counted_between(*arguments: Any) -> Any:
        counts["between"] += 1
        return between(*arguments)

    def counted_pose(*arguments: Any) -> Any:
        counts["pose"] += 1
        return pose(*arguments)

    monkeypatch.setattr(geoms, "contacts_between", counted_between)
    monkeypatch.setattr(Tree, "pose", counted_pose)
    robot = read(tmp_path, chain(60))
    assert counts == {"between": len(robot.friction), "pose": 60}
    assert len(robot.friction) == 60 * 59 // 2 - 59
