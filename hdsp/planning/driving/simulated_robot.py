"""A robot on its ground in MuJoCo: positions, contacts and motors by foot."""

from __future__ import annotations

import os
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.motion.local_motion import Place
from hdsp.planning.driving.ground_model import GroundModel
from hdsp.planning.driving.robot_model import Dimensions, add_light, add_robot
from hdsp.robot.robot import FEET, Robot
from hdsp.robot.urdf import BASE_FRAME, leg_joints, wheel_frame
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Scene


def import_mujoco() -> Any:
    """Imports MuJoCo.

    Raises:
        InputError: MuJoCo is missing.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")  # renders without a display
    try:
        import mujoco
    except ImportError as error:
        raise InputError(f"driving needs MuJoCo ({error}); install it with: pip install 'hdsp[simulation]'") from None
    return mujoco


class SimulatedRobot:
    """A robot and its ground.

    Convention: world frame of the terrain, relative to ``place``; feet in the order of ``FEET``. A foot is the point in
    which a wheel on level ground touches it.

    Attributes:
        robot, size: the robot and its values for the simulation.
        model, data: MuJoCo's model and state.
    """

    def __init__(self, robot: Robot, terrain: HeightMap | Scene, place: Place = (0.0, 0.0)):
        self._mujoco = mujoco = import_mujoco()
        self.robot, self.size = robot, Dimensions.of(robot)
        root = ElementTree.Element("mujoco", model=robot.name)
        add_light(root)
        ground = GroundModel(root, terrain, place)
        add_robot(root, robot, np.array([0.0, 0.0, 1.0]))
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        if ground.field is not None:
            self.model.hfield_data[:] = ground.field
        self.data = mujoco.MjData(self.model)
        model = self.model
        self.base_body = self._base = model.body(BASE_FRAME).id
        self._wheels = np.array([model.body(wheel_frame(foot)).id for foot in FEET])
        joints = [[model.joint(name).id for name in leg_joints(foot)] for foot in FEET]
        self._slides, self._slide_speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.slide_motors = np.array([[model.actuator(name).id for name in leg_joints(foot)] for foot in FEET])
        self.wheel_motors = np.array([model.actuator(f"{foot}_wheel_joint").id for foot in FEET])
        spins = [model.joint(f"{foot}_wheel_joint").id for foot in FEET]
        self._spin_speeds = model.jnt_dofadr[spins]
        if self.size.steers:
            steering = [model.joint(f"{foot}_steering").id for foot in FEET]
            self._steering = model.jnt_qposadr[steering]
            self.steering_motors = np.array([model.actuator(f"{foot}_steering").id for foot in FEET])
        self._foot_of_geom = np.full(model.ngeom, -1)
        for foot, name in enumerate(FEET):
            self._foot_of_geom[model.geom(f"{name}_tyre").id] = foot
        self._of_robot = model.body_rootid[model.geom_bodyid] == self._base
        self._force = np.zeros(6)
        self._limits = model.actuator_forcerange[:, 1] * (1 - 1e-6)
        self._hips, self._up = robot.hips(), np.array([0.0, 0.0, self.size.radius])

    def place(self, base: np.ndarray, feet: np.ndarray) -> None:
        """Places the robot at rest: base [6] as in a motion, feet [4, 3]."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_euler("ZYX", [base[5], base[4], base[3]])
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:3] = base[:3]
        self.data.qpos[3:7] = np.roll(turned.as_quat(), 1)
        self.data.qpos[self._slides] = self.slides_for(base[:3], turned.as_matrix(), feet)
        self._mujoco.mj_forward(self.model, self.data)

    def slides_for(self, place: np.ndarray, rotation: np.ndarray, feet: np.ndarray) -> np.ndarray:
        """Leg joint positions, float64 [4, 3], m, for a base position [3], its rotation [3, 3] and feet [4, 3]."""
        return (feet + self._up - place) @ rotation - self._hips

    def feet_from(self, place: np.ndarray, rotation: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Feet, float64 [4, 3], m, for a base position [3], its rotation [3, 3] and leg joints [4, 3]."""
        return (slides + self._hips) @ rotation.T + place - self._up

    def step(self) -> None:
        """Advances by one time step."""
        self._mujoco.mj_step(self.model, self.data)

    @property
    def time_step(self) -> float:
        """Time step, s."""
        return float(self.model.opt.timestep)

    def base_place(self) -> np.ndarray:
        """Base origin, float64 [3], m."""
        return self.data.qpos[:3].copy()

    def rotation(self) -> np.ndarray:
        """Rotation from the base frame to the world frame, float64 [3, 3]."""
        return self.data.xmat[self._base].reshape(3, 3)

    def turn_rate(self) -> np.ndarray:
        """Angular velocity in the world frame, float64 [3], rad/s."""
        return self.rotation() @ self.data.qvel[3:6]

    def velocity(self) -> np.ndarray:
        """Velocity of the base origin, float64 [3], m/s."""
        return self.data.qvel[:3].copy()

    def slides(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and speeds of the leg joints, float64 [4, 3] each, m and m/s."""
        return self.data.qpos[self._slides], self.data.qvel[self._slide_speeds]

    def steering(self) -> np.ndarray:
        """Steering angles against the base, float64 [4], rad."""
        return self.data.qpos[self._steering] if self.size.steers else np.zeros(4)

    def spin_speeds(self) -> np.ndarray:
        """Speeds of the wheels about their axles, float64 [4], rad/s."""
        return self.data.qvel[self._spin_speeds]

    def feet(self) -> np.ndarray:
        """Lowest points of the wheels, float64 [4, 3], m."""
        return self.data.xpos[self._wheels] - self._up

    def center_of_mass(self) -> np.ndarray:
        """Centre of mass of the whole robot, float64 [3], m."""
        return self.data.subtree_com[self._base]

    def contacts(self) -> tuple[np.ndarray, bool]:
        """Ground forces on the wheels in the world frame, float64 [4, 3], N, and whether the body touches."""
        forces, touched, data = np.zeros((4, 3)), False, self.data
        contact = data.contact
        for k in range(data.ncon):
            geom = contact.geom[k]
            of_robot = geom[1] if self._of_robot[geom[1]] else geom[0]
            foot = self._foot_of_geom[of_robot]
            if foot < 0:
                touched = True
                continue
            self._mujoco.mj_contactForce(self.model, data, k, self._force)
            sign = 1.0 if of_robot == geom[1] else -1.0
            forces[foot] += sign * (self._force[:3] @ contact.frame[k].reshape(3, 3))
        return forces, touched

    def motor_power(self) -> float:
        """Mechanical power of all motors, W; a motor that brakes takes nothing back."""
        power = self.data.actuator_force * self.data.actuator_velocity
        return float(np.maximum(power, 0.0).sum())

    def saturated(self) -> bool:
        """Whether a motor is at its limit."""
        return bool((np.abs(self.data.actuator_force) >= self._limits).any())
