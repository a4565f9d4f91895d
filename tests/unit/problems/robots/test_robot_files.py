"""Robots from files: reported features, floating URDFs, hulls of meshes, servos."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ocp.errors import InputError
from problems import robots

ROOT = Path(__file__).parents[4]


def test_what_is_not_used_is_told_by_name(tmp_path: Path) -> None:
    file = tmp_path / "odd.xml"
    file.write_text("""<mujoco>
      <option timestep="0.001" density="1.2"><flag limit="disable"/></option>
      <asset><hfield name="h" nrow="9" ncol="9" size="1 1 1 1"/></asset>
      <worldbody>
        <geom name="hills" type="hfield" hfield="h" pos="9 9 0"/>
        <geom name="floor" type="plane" size="0 0 1"/>
        <body name="a" pos="0 0 2" gravcomp="0.5">
          <joint name="j" axis="0 1 0" frictionloss="0.1" stiffness="3" springref="20"/>
          <geom name="ball" size=".1" pos=".1 0 0" solref="0.05 1" condim="6"/>
          <geom name="egg" type="ellipsoid" size=".1 .2 .1"/>
          <site name="s"/><geom name="hub" size=".05"/>
          <body name="b" pos="1 0 0">
            <joint name="k" axis="0 -1 0" ref="30"/>
            <geom name="rod" type="capsule" fromto="0 0 0 .3 .2 0" size=".02"/>
          </body>
          <body name="c" pos="1 0 1">
            <joint name="l" axis="0 1 0"/><geom name="stone" type="box" size=".1 .1 .2"/>
          </body>
        </body>
      </worldbody>
      <tendon><fixed name="rope"><joint joint="j" coef="1"/></fixed></tendon>
      <equality><joint name="tie" joint1="j" joint2="k"/></equality>
      <actuator><motor name="m" joint="j"/>
        <position name="servo" joint="k" kp="2" kv="1" forcerange="-1 1"/>
        <position name="pull" joint="l" timeconst="0.1"/>
        <motor name="rope" tendon="rope"/></actuator>
      <keyframe><key name="other"/></keyframe>
      <sensor><jointpos name="angle" joint="j"/></sensor>
    </mujoco>""")
    robot = robots.load(file)
    told = "\n".join(robot.ignored)
    for words in (
        "sensor angle: sensors are not simulated",
        "options timestep, density, limit: settings of a",
        "solref of geom ball:",
        "frictionloss of joint j:",
        "gravcomp of body a:",
        "tendon rope:",
        "actuators pull, rope: only motors",
        "site s: no force acts at sites",
        "geom egg: it is of the kind ellipsoid, and has no contacts",
        "geom hills: it is of the kind hfield",
        "torsional and rolling",
        "1 pair of geoms, hub and floor: no joint moves them",
        "key other:",
        "force range of actuator servo: the force of a servo is not limited",
    ):
        assert words in told, told
    assert robot.notes == ("Joint a follows: a = 1 b + -0.523599.", "The kv of actuator servo is part of the damping.")
    assert [actuator.name for actuator in robot.actuators] == ["m", "servo"]
    assert np.isinf(robot.controls).all()
    np.testing.assert_allclose(robot.home, [0, np.radians(30), 0])


def test_what_free_and_ball_joints_have_and_ours_have_not_is_told() -> None:
    robot = robots.load(ROOT / "tests/data/crane.xml")
    told = "\n".join(robot.ignored)
    for words in (
        "armature of joint swivel: only hinges",
        "limit of joint swivel:",
        "spring of joint swivel:",
        "geom egg: it is of the kind ellipsoid",
        "1 pair of geoms, mast and block: a contact of Box and Box is not known",
        "2 pairs of geoms, far and floor, far and block: they can never meet",
    ):
        assert words in told, told
    assert not robot.floats
    goal = np.array(ca.evalf(robot.displaced(robot.home, 0.1))).ravel() - robot.home
    # The boom turns and its trolley moves to its limit; the ball joint stays at rest.
    np.testing.assert_allclose(goal, [0.1, 0.05, 0, 0, 0, 0, 0.05])


def test_inputs_of_servos_are_positions_within_their_range() -> None:
    robot = robots.load(ROOT / "tests/data/servos.xml")
    hip, knee, toe = robot.machine.bodies
    assert (hip.servo, hip.gear, knee.servo, knee.gear) == (160, None, None, 3)
    assert (hip.damping, knee.damping, toe.servo) == (0.1 + 8, 3, 300)
    np.testing.assert_allclose(robot.controls, [[-1, 0.5], [-np.inf, np.inf], [0, 0.1]])
    np.testing.assert_allclose(robot.holding_inputs(robot.home), [0.3, 0, 0.02])
    assert robot.notes == ("The kv of actuators hip, knee is part of the damping.",)
    assert "force range of actuator toe: the force of a servo is not limited" in robot.ignored


NAMES = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
  <geom name="{0}" type="box" size="1 1 1" pos="3 0 0" friction="2"/>
  <body name="a" pos="0 0 1"><freejoint/>
    <geom name="leg" type="capsule" size=".1 .3" friction="0.5"/>
    <geom name="{1}" size=".1" friction="0.7"/></body></worldbody></mujoco>"""


def test_all_points_of_a_pair_have_its_coefficient_whatever_it_is_called(tmp_path: Path) -> None:
    file = tmp_path / "r.xml"
    file.write_text(NAMES.format("floor 1", "leg on"))
    robot = robots.load(file)
    assert robot.friction == {
        "leg on floor 1": 1,
        "leg on floor 2": 1,
        "leg on on floor": 1,
        "leg on floor 1 1": 2,
        "leg on floor 1 2": 2,
        "leg on on floor 1": 2,
    }
    assert [list(robot.friction)[k] for k in robot.grounds] == ["leg on floor 1", "leg on floor 2", "leg on on floor"]
    file.write_text(NAMES.format("top on floor", "leg on top").replace("capsule", "sphere"))
    with pytest.raises(InputError, match="two contacts are called 'leg on top on floor'"):
        robots.load(file)


LINK = """<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/></inertial>
  <collision><geometry>{shape}</geometry></collision></link>"""
SOLID = 'ixx="0.1" iyy="0.2" izz="0.25" ixy="0.01" ixz="0" iyz="0"'
DUMMY = 'ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="1e-6" ixz="1e-6" iyz="1e-6"'


def urdf(shape: str, moments: str = SOLID, mass: float = 2.0) -> str:
    return f"""<robot name="r">
      {LINK.format(name="trunk", mass=2, moments=SOLID, shape='<box size="0.4 0.2 0.1"/>')}
      {LINK.format(name="foot", mass=mass, moments=moments, shape=shape)}
      <joint name="knee" type="revolute"><origin xyz="0 0 -0.3"/><parent link="trunk"/>
        <child link="foot"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="5"/></joint>
      </robot>"""


def test_a_urdf_floats_on_demand_and_stands_on_the_ground(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(urdf('<sphere radius="0.05"/>'))
    fixed, free = robots.load(file), robots.load(file, floating=True)
    assert fixed.notes[0] == "The root is fixed; --floating makes it free." and not fixed.floats
    assert free.floats and free.mass == pytest.approx(4) and not any("--fl" in n for n in free.notes)
    assert [body.joint for body in free.machine.bodies] == ["free", "hinge"]
    stood = free.standing()
    assert stood[2] == pytest.approx(0.35) and free.controls.tolist() == [[-1, 1]]
    assert float(np.array(free.distances(stood)).min()) == pytest.approx(0, abs=1e-12)
    goal = np.array(ca.evalf(free.displaced(stood, 0.3))).ravel()
    np.testing.assert_allclose(goal - stood, [0.3, 0, 0, 0, 0, 0, 0, 0])
    state = np.concatenate([stood, np.zeros(7)])
    assert free.shapes(state) and len(free.frames(state, 1.0)) == len(free.friction) == 9
    file.write_text(urdf('<sphere radius="0.05"/>').replace("trunk", "world"))
    with pytest.raises(InputError, match="a URDF must have a single link"):
        robots.load(file, floating=True)
    with pytest.raises(InputError, match="in MJCF <freejoint/> makes a body float"):
        robots.load(ROOT / "tests/data/crane.xml", floating=True)


def test_products_of_inertia_of_a_dummy_are_left_out(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(urdf('<sphere radius="0.05"/>', DUMMY, 1e-6))
    robot = robots.load(file)
    assert "products of inertia of link foot: no body can have them" in robot.ignored
    file.write_text(urdf('<sphere radius="0.05"/>', DUMMY))
    with pytest.raises(InputError, match="positive eigenvalues"):
        robots.load(file)


def write_mesh(file: Path, corners: np.ndarray) -> None:
    """Write an OBJ file of the convex hull of ``corners``."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    for face, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = face
        out = np.cross(corners[b] - corners[a], corners[c] - corners[a]) @ plane[:3] > 0
        lines.append("f {} {} {}".format(*(np.array([a, b, c] if out else [a, c, b]) + 1)))
    file.write_text("\n".join(lines))


def test_hulls_of_meshes_meet_the_ground(tmp_path: Path) -> None:
    """A cube has all its corners; a ball of 300 corners has 32, as deep inside as reported."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "outside").mkdir()
    directions = np.random.default_rng(0).normal(size=(300, 3))
    ball = 0.1 * directions / np.linalg.norm(directions, axis=1)[:, None]
    cube = 0.1 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    file = tmp_path / "r.urdf"
    found = {}
    for name, corners in {"ball": ball, "cube": cube}.items():
        write_mesh(tmp_path / f"meshes/{name}.obj", corners)
        file.write_text(urdf(f'<mesh filename="package://pkg/meshes/{name}.obj"/>'))
        robot = robots.load(file, floating=True)
        found[name] = [k for k, contact in enumerate(robot.friction) if "foot" in contact]
        told = [one for one in robot.ignored if one.startswith("hull")]
        lowest = np.array(robot.distances(robot.home)).ravel()[found[name]].min()
        # Its origin is 0.3 m below the trunk's, which is at the ground.
        exact = corners[:, 2].min() - 0.3
        if name == "ball":
            assert told[0].startswith("hull of mesh foot geom 1: 32 corners, at most ")
            most = 1e-3 * float(told[0].split()[-3])
            assert exact - 1e-6 <= lowest <= exact + 1.05 * most and 0.01 < most < 0.03
        else:
            assert not told and lowest == pytest.approx(exact, abs=1e-6)
    assert {name: len(own) for name, own in found.items()} == {"ball": 32, "cube": 8}
    file.write_text(urdf('<mesh filename="package://pkg/meshes/none.stl"/>'))
    (told,) = [one for one in robots.load(file, floating=True).ignored if one.startswith("mesh")]
    assert told == (
        "mesh of link foot: no STL, OBJ or MSH file in the robot's folder, so it has no contacts;"
        " --folder DIR names a folder around it"
    )
