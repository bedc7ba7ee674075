"""Robot description, and the lattices for its planning.

- `robot`: a robot as data; presets are YAML files in `presets`
- `shape`, `action_limits`, `quantities`: its feet, body and legs; limits and costs of its actions; their units
- `lattice`: detailed and abstract lattice, abstract actions, conversions between their coordinates and the world
- `motion_limits`: limits of speed and acceleration, for the times of motions
- `physics`: masses, wheels and motors, for a simulation
- `urdf`: a robot as URDF
- `schema`: JSON schema and documentation page of the robot file
"""

from hdsp.robot.action_limits import BaseShift, DeviationCost, Drive, FootMove, Step, Turn
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    ABSTRACT_RESOLUTION,
    DRIVE_MOVES,
    HEADINGS,
    PATCH_CELLS,
    RESOLUTION,
    Grid,
    abstract_anchor,
    abstract_shape,
    cells,
    detailed_to_abstract,
    heading_angle,
    heading_index,
    metres,
    robot_frame_goals,
)
from hdsp.robot.motion_limits import Accelerations, Speeds
from hdsp.robot.physics import Physics
from hdsp.robot.robot import FEET, Robot
from hdsp.robot.shape import Body, Box, Feet, Legs, Rectangle, Stance
from hdsp.robot.urdf import robot_urdf

__all__ = [
    "ABSTRACT_ACTIONS",
    "ABSTRACT_HEADINGS",
    "ABSTRACT_RESOLUTION",
    "DRIVE_MOVES",
    "FEET",
    "HEADINGS",
    "PATCH_CELLS",
    "RESOLUTION",
    "Accelerations",
    "BaseShift",
    "Body",
    "Box",
    "DeviationCost",
    "Drive",
    "Feet",
    "FootMove",
    "Grid",
    "Legs",
    "Physics",
    "Rectangle",
    "Robot",
    "Speeds",
    "Stance",
    "Step",
    "Turn",
    "abstract_anchor",
    "abstract_shape",
    "cells",
    "detailed_to_abstract",
    "heading_angle",
    "heading_index",
    "metres",
    "robot_frame_goals",
    "robot_urdf",
]
