"""Robot description: shape, limits and cost constants as data. Presets are YAML files in ``hdsp/robot/presets``.

A new robot needs one YAML file like ``presets/momaro.yaml``; its path works wherever a robot name does.
"""

import hashlib
import json
import math
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import FileName, checked, fault, load_settings
from hdsp.base.yaml_files import Document, parse_yaml, read_yaml
from hdsp.robot.action_limits import BaseShift, Drive, FootMove, Slope, Step, Turn
from hdsp.robot.lattice import offset_steps
from hdsp.robot.motion_limits import Accelerations, Speeds
from hdsp.robot.physics import Physics
from hdsp.robot.shape import Body, Feet, Legs, Stance

_PRESETS = resources.files("hdsp.robot") / "presets"

#: Foot order in every array with a foot axis.
FEET = ("front_left", "rear_left", "rear_right", "front_right")

#: Robot parts with influence on motions, but not on plans or labels.
_OF_MOTIONS = ("legs", "stance", "speeds", "accelerations", "physics")


@checked
class Robot:
    """All values that the planner knows about a robot.

    Convention: metres and radians in the robot frame, x forward, y left; feet in ``FEET`` order. Costs are unitless.

    Attributes:
        name: robot name; trained abstractions refer to it.
        feet: foot positions, clearance and contact ground.
        body: space for the body.
        drive: driving, and its ground limits.
        slope: steepest ground.
        turn: rotation.
        foot_move: drive motion of one foot along x.
        base_shift: base motion over resting feet.
        step: steps with single feet.
        legs: hips and leg lengths.
        stance: base limits when a plan becomes a motion.
        speeds: largest speeds in a motion.
        accelerations: largest accelerations in a motion.
        physics: masses, wheels and motors in a simulation.
    """

    name: FileName
    feet: Feet
    body: Body
    drive: Drive
    slope: Slope
    turn: Turn
    foot_move: FootMove
    base_shift: BaseShift
    step: Step
    legs: Legs
    stance: Stance
    speeds: Speeds = Speeds()
    accelerations: Accelerations = Accelerations()
    physics: Physics = Physics()

    @model_validator(mode="after")
    def _check(self) -> Self:
        for lean in ("max_pitch", "max_roll"):
            of_base, of_ground = getattr(self.stance, lean), getattr(self.slope, lean)
            if of_base < of_ground:
                raise fault(f"stance.{lean}", of_base, f"at least slope.{lean}, {of_ground:g}: the base leans with it")
        legs, height = self.legs, self.stance.base_height
        if not legs.min_length <= height <= legs.max_length:
            reach = f"{legs.min_length:g} to {legs.max_length:g} m (legs.min_length, legs.max_length)"
            raise fault("stance.base_height", height, f"a height that the legs reach, {reach}")
        return self

    def __repr__(self) -> str:
        wheels = f"wheels pass edges of {self.drive.highest_edge:g} m"
        steps = f"steps of up to {self.step.max_length:g} m in length, {self.step.max_height:g} m in height"
        return f"Robot({self.name}: {wheels}, {steps if self.step.max_length else 'no steps'})"

    @classmethod
    def load(cls, source: "str | Path | dict | Robot") -> "Robot":
        """Loads a robot from a preset name, a YAML file path, or a mapping with the same keys.

        Raises:
            InputError: the preset or file does not exist, a key is unknown or missing, a value is out of range, or
                nothing tells the size of the wheels.

        Example:
            >>> robot = Robot.load("momaro")
            >>> robot.name, robot.step.max_height
            ('momaro', 0.3)
        """
        if not isinstance(source, str | Path):
            return _with_wheels(load_settings(cls, source, "robot"))
        path = Path(source)
        if path.suffix in (".yaml", ".yml"):
            document = read_yaml(path, "robot file")
        elif str(source) in cls.presets():
            document = parse_yaml(_PRESETS.joinpath(f"{source}.yaml").read_text(), f"preset {source}")
        else:
            presets = ", ".join(cls.presets())
            raise InputError(f"unknown robot {str(source)!r}: presets are {presets}, or give a .yaml file")
        return _with_wheels(load_settings(cls, document.values, "robot", document), document)

    @staticmethod
    def presets() -> list[str]:
        """Returns the preset names."""
        return sorted(f.name[:-5] for f in _PRESETS.iterdir() if f.name.endswith(".yaml"))

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def hash(self) -> str:
        """Returns a hex digest over all values with influence on plans and labels; the same on any machine."""
        values = {part: value for part, value in self.to_dict().items() if part not in _OF_MOTIONS}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    def neutral_feet(self) -> np.ndarray:
        """Returns the neutral foot positions (x, y) in the robot frame, float64 [4, 2], m."""
        x, y = self.feet.neutral_x, self.feet.neutral_y
        return np.array([(x, y), (-x, y), (-x, -y), (x, -y)])

    def foot_positions(self, states) -> np.ndarray:
        """Returns the feet's world positions (x, y), float64 [..., 4, 2] m, at detailed states [..., 7] (m, m, rad, 4 x
        m).

        Convention: foot offsets are along the robot's x axis, from the neutral positions.
        """
        states = np.asarray(states, float)
        ahead = self.neutral_feet()[:, 0] + states[..., 3:]
        aside = self.neutral_feet()[:, 1]
        cos, sin = np.cos(states[..., 2:3]), np.sin(states[..., 2:3])
        turned = np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=-1)
        return turned + states[..., None, :2]

    def hips(self) -> np.ndarray:
        """Returns the hips (x, y, z) in the base frame, float64 [4, 3], m."""
        x, y = self.legs.hip_x, self.legs.hip_y
        return np.array([(x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0), (x, -y, 0.0)])

    def offset_range(self) -> tuple[int, int]:
        """Returns the smallest and largest foot offset in lattice steps."""
        low, high = offset_steps([self.feet.offset_min, self.feet.offset_max])
        return int(low), int(high)

    def reach(self) -> float:
        """Returns the distance (m) from the base centre that no robot part and no foothold ever exceeds."""
        x = self.feet.neutral_x + max(self.feet.offset_max, -self.feet.offset_min) + self.step.max_length
        corners = [math.hypot(max(abs(r.x_min), abs(r.x_max)), r.half_width) for r in self.body.boxes]
        return max(math.hypot(x, self.feet.neutral_y), *corners)


def _with_wheels(robot: Robot, document: Document | None = None) -> Robot:
    """Returns a robot whose wheels have a size; limits without a clearance are for planners, which need no wheels."""
    if robot.feet.clearance or robot.physics.wheel_radius or robot.drive.wheel_radius:
        return robot
    where = "" if document is None else f"{document.name}, line {document.line(['feet', 'clearance'])}: "
    need = "more than 0, or a physics.wheel_radius: without one, the clearance is the radius of the wheels"
    raise InputError(f"{where}robot.feet.clearance is 0; need {need}")
