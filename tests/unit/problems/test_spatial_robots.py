"""Robots of files in space are MuJoCo's: frames, masses, forces, distances; what is told."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from ocp.errors import InputError
from problems import robots
from problems.robots import Robot
from problems.robots.bodies import bodies
from problems.robots.pairs import geom_names

mujoco: Any = import_module("mujoco")
ROOT = Path(__file__).parents[3]
GYM = Path(import_module("gymnasium").__file__ or "").parent / "envs/mujoco/assets"
FILES = {
    **{k: GYM / f"{k}.xml" for k in ("ant", "swimmer", "reacher", "humanoid", "hopper")},
    "pusher": GYM / "pusher_v5.xml",
    "crane": ROOT / "tests/data/crane.xml",
}
NEAR = 1e-9


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """MuJoCo's own handler of warnings writes a file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    yield
    mujoco.set_mju_user_warning(before)


@cache
def loaded(name: str) -> tuple[Robot, Any]:
    return robots.load(FILES[name], space=True), mujoco.MjModel.from_xml_path(str(FILES[name]))


def states(model: Any, count: int) -> Iterator[Any]:
    rng, data = np.random.default_rng(7), mujoco.MjData(model)
    model.opt.density = model.opt.viscosity = 0
    # Ours has neither in ball joints.
    for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        model.jnt_stiffness[j] = 0
        model.dof_armature[model.jnt_dofadr[j] :][:3] = 0
    for _ in range(count):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, model.nq), rng.uniform(-5, 5, model.nv)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        yield data


def mass(model: Any, data: Any) -> np.ndarray:
    M, column = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        M[:, i] = column
    return M


def relative(ours: Any, theirs: Any) -> float:
    ours, theirs = np.array(ours).ravel(), np.array(theirs).ravel()
    return float(np.abs(ours - theirs).max() / max(1e-3, np.abs(theirs).max()))


def check_dynamics(robot: Robot, model: Any, count: int = 100) -> None:
    """M, bias, energy, forces of springs and dampers, and where every body of the file is."""
    tree: Any = robot.tree
    q, v = ca.SX.sym("q", tree.nq), ca.SX.sym("v", tree.nv)
    assert (tree.nq, tree.nv, len(robot.joints)) == (model.nq, model.nv, model.nq)
    stiff, damped, rest = (
        tree.each(lambda body, key=key: getattr(body, key)) for key in ("spring", "damping", "rest")
    )
    passive = -stiff * (tree.position_of(q) - rest) - damped * v
    carriers = bodies(model).carriers
    poses = [tree.pose(q, carriers[b].name) for b in range(1, model.nbody)
             if carriers[b].name != "world"]  # fmt: skip
    moved = [b for b in range(1, model.nbody) if carriers[b].name != "world"]
    ours = ca.Function(
        "ours", [q, v],
        [tree.mass(q), tree.bias(q, v), tree.energy(q, v), passive, *(x for p in poses for x in p)],
    )  # fmt: skip
    for data in states(model, count):
        M, bias, energy, force, *frames = ours(data.qpos, data.qvel)
        assert relative(M, mass(model, data)) < NEAR
        assert relative(bias, data.qfrc_bias) < NEAR
        assert relative(force, data.qfrc_spring + data.qfrc_damper) < NEAR
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        assert abs(float(energy) - data.energy.sum()) < NEAR * max(1, abs(data.energy).max())
        for b, R, p in zip(moved, frames[::2], frames[1::2], strict=True):
            pose = carriers[b].pose
            place = np.array(p).ravel() + np.array(R) @ pose.place
            turned = np.array(R) @ pose.turn.as_matrix()
            np.testing.assert_allclose(place, data.xpos[b], atol=1e-12)
            np.testing.assert_allclose(turned, data.xmat[b].reshape(3, 3), atol=1e-12)


@pytest.mark.parametrize("name", FILES)
def test_masses_forces_energies_and_frames_are_those_of_mujoco(name: str) -> None:
    check_dynamics(*loaded(name))


@pytest.mark.parametrize("name", ["ant", "crane", "humanoid"])
def test_distances_are_those_of_mujoco(name: str) -> None:
    """From a plane the nearest of all points, of two round parts the one distance they have."""
    robot, model = loaded(name)
    names, groups = geom_names(model), {}
    for k, contact in enumerate(robot.friction):
        one, _, other = contact.partition(" on ")
        other = other if other in names else other.rpartition(" ")[0]
        groups.setdefault((names.index(one), names.index(other)), []).append(k)
    seen = set()
    for data in states(model, 20):
        ours = np.array(robot.distances(data.qpos)).ravel()
        for (one, other), own in groups.items():
            theirs = mujoco.mj_geomDistance(model, data, one, other, 50.0, None)
            if theirs > 0 or model.geom_type[other] == mujoco.mjtGeom.mjGEOM_PLANE:
                assert ours[own].min() == pytest.approx(theirs, rel=NEAR, abs=1e-10)
                seen.add((one, other))
    assert groups and len(seen) > 0.9 * len(groups)


@pytest.mark.parametrize("name", ["ant", "crane"])
def test_limits_motors_and_home_are_those_of_the_file(name: str) -> None:
    robot, model = loaded(name)
    tree: Any = robot.tree
    for _, at, _, low, high in tree.limits:
        joint = model.joint(robot.joints[at])
        np.testing.assert_allclose([low, high], joint.range)
    assert len(tree.limits) == sum(
        bool(limited) and kind >= 2
        for limited, kind in zip(model.jnt_limited, model.jnt_type, strict=True)
    )
    np.testing.assert_array_equal(robot.home, model.key_qpos[0] if model.nkey else model.qpos0)
    order = [model.actuator_trnid[:, 0].tolist().index(model.joint(one).id) for one in moved(robot)]
    np.testing.assert_array_equal(robot.controls, model.actuator_ctrlrange[order])
    data, u = mujoco.MjData(model), np.linspace(-0.3, 0.4, model.nu)
    data.ctrl[order] = u
    mujoco.mj_forward(model, data)
    force = np.zeros(model.nv)
    for body, value in zip(tree.actuated, u, strict=True):
        force[tree.v_of[body]] = float(tree.bodies[body].gear) * value
    np.testing.assert_allclose(force, data.qfrc_actuator, atol=1e-12)


def moved(robot: Robot) -> list[str]:
    """Joints of the motors in the order of ours."""
    tree: Any = robot.tree
    return [robot.joints[tree.q_of[body].start] for body in tree.actuated]


def test_what_free_and_ball_joints_have_and_ours_have_not_is_told() -> None:
    robot, _ = loaded("crane")
    told = "\n".join(robot.ignored)
    for words in (
        "armature of joint swivel: only hinges", "limit of joint swivel:",
        "spring of joint swivel:",
        "equality constraint loop: only joints bind links", "geom egg: it is an ellipsoid",
        "1 pair of geoms, block and mast: a box and a box never touch here",
        "4 pairs of geoms, floor and far, floor and rope, block and far and 1 more: can never",
    ):  # fmt: skip
        assert words in told, told
    assert not robot.floats
    goal = np.array(ca.evalf(robot.displaced(robot.home, 0.1))).ravel() - robot.home
    # The boom turns and its trolley runs, up to its limit; the ball joint stays.
    np.testing.assert_allclose(goal, [0.1, 0.05, 0, 0, 0, 0, 0.05])


def test_pairs_that_are_left_out_never_meet() -> None:
    """Random poses within the limits find no pair of them in touch."""
    robot, model = loaded("crane")
    del robot
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    far, floor = model.geom("far").id, model.geom("floor").id
    low, high = model.jnt_range[[0, 1, 3]].T
    at = model.jnt_qposadr[[0, 1, 3]]
    for _ in range(200):
        data.qpos[at] = rng.uniform(low, high)
        data.qpos[2:6] = rng.normal(size=4)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        assert mujoco.mj_geomDistance(model, data, floor, far, 50.0, None) > 0


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
    assert (
        free.floats and free.mass == pytest.approx(4) and not any("--fl" in n for n in free.notes)
    )
    assert [link.joint for link in free.links] == ["free", "hinge"]
    stood = free.standing()
    assert stood[2] == pytest.approx(0.35) and free.controls.tolist() == [[-1, 1]]
    assert float(np.array(free.distances(stood)).min()) == pytest.approx(0, abs=1e-12)
    goal = np.array(ca.evalf(free.displaced(stood, 0.3))).ravel()
    np.testing.assert_allclose(goal - stood, [0.3, 0, 0, 0, 0, 0, 0, 0])
    state = np.concatenate([stood, np.zeros(7)])
    assert free.shapes(state) and len(free.frames(state, 1.0)) == len(free.friction) == 9
    file.write_text(urdf('<sphere radius="0.05"/>').replace("trunk", "world"))
    with pytest.raises(InputError, match="the link called world never moves"):
        robots.load(file, floating=True)
    with pytest.raises(InputError, match="an MJCF file says itself what floats"):
        robots.load(FILES["ant"], floating=True)


def test_products_of_inertia_of_a_dummy_are_left_out(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(urdf('<sphere radius="0.05"/>', DUMMY, 1e-6))
    robot = robots.load(file)
    assert "products of inertia of link foot: no body has them" in robot.ignored
    file.write_text(urdf('<sphere radius="0.05"/>', DUMMY))
    with pytest.raises(InputError, match="positive eigenvalues"):
        robots.load(file)


def write_mesh(file: Path, corners: np.ndarray) -> None:
    """An OBJ file of a convex body."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    for face, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = face
        out = np.cross(corners[b] - corners[a], corners[c] - corners[a]) @ plane[:3] > 0
        lines.append("f {} {} {}".format(*(np.array([a, b, c] if out else [a, c, b]) + 1)))
    file.write_text("\n".join(lines))


def test_hulls_of_meshes_meet_the_ground(tmp_path: Path) -> None:
    """Of a cube all corners; of a ball of 300 corners 32, and as deep inside as is told."""
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
        # Its origin hangs 0.3 below the trunk's, which is at the ground.
        exact = corners[:, 2].min() - 0.3
        if name == "ball":
            assert told[0].startswith("hull of mesh foot geom 1: 32 of 300 corners, at most ")
            most = 1e-3 * float(told[0].split()[-3])
            assert exact - 1e-6 <= lowest <= exact + 1.2 * most and 0.01 < most < 0.03
        else:
            assert not told and lowest == pytest.approx(exact, abs=1e-6)
    assert {name: len(own) for name, own in found.items()} == {"ball": 32, "cube": 8}
    file.write_text(urdf('<mesh filename="package://pkg/meshes/none.stl"/>'))
    (told,) = [one for one in robots.load(file, floating=True).ignored if one.startswith("mesh")]
    assert told == (
        "mesh of link foot: no STL, OBJ or MSH file in the robot's folder, so it touches nothing"
    )


def test_planar_robots_stay_planar_and_are_read_in_space_on_demand() -> None:
    file = FILES["hopper"]
    assert not hasattr(robots.load(file).machine, "bodies")
    assert robots.load(file, space=True).notes == ()
