"""A MuJoCo world for an arena, with the arena's blocks as geoms, for ray casting and images.

Convention: world coordinates of the arena, z up, the ground at z = 0; m, rad.
"""

from __future__ import annotations

import math
import os

import numpy as np

from hdsp.base.errors import InputError
from hdsp.terrain.arenas import Arena
from hdsp.terrain.obstacles import Block, Ramp

_COLORS = {"wall": ".78 .76 .72 1", "block": ".80 .55 .30 1", "ramp": ".45 .62 .55 1"}
_WALL = 0.7  # m; blocks at least this high are drawn as walls


def mjcf(arena: Arena) -> str:
    """The arena in MuJoCo's XML format: a plane, a box for each block, a wedge (a convex mesh) for each ramp."""
    blocks = arena.blocks()
    ramps = [block for block in blocks if isinstance(block, Ramp)]
    meshes = "\n".join(f'    <mesh name="ramp{i}" vertex="{_wedge(ramp)}"/>' for i, ramp in enumerate(ramps))
    boxes = "\n".join(_box(block) for block in blocks if not isinstance(block, Ramp))
    wedges = "\n".join(
        f'    <geom type="mesh" mesh="ramp{i}" pos="{ramp.x} {ramp.y} 0" euler="0 0 {ramp.yaw}" '
        f'rgba="{_COLORS["ramp"]}"/>'
        for i, ramp in enumerate(ramps)
    )
    half = arena.size / 2
    return f"""<mujoco model="arena">
  <compiler angle="radian" inertiafromgeom="false"/>
  <visual>
    <global offwidth="2000" offheight="2000"/>
    <headlight ambient=".45 .45 .45" diffuse=".1 .1 .1" specular="0 0 0"/>
    <quality shadowsize="8192"/>
    <map znear="0.01"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="48"/>
    <texture name="floor" type="2d" builtin="checker" rgb1=".92 .92 .90" rgb2=".84 .84 .82" width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="{half} {half}"/>
{meshes}
  </asset>
  <worldbody>
    <light pos="{half} {half} {arena.size}" dir=".25 -.15 -1" type="directional" castshadow="true"
      diffuse=".5 .5 .5" specular="0 0 0"/>
    <geom name="floor" type="plane" pos="{half} {half} 0" size="{half} {half} 1" material="floor"/>
{boxes}
{wedges}
  </worldbody>
</mujoco>
"""


def _box(block: Block) -> str:
    kind = "wall" if block.height >= _WALL else "block"
    return (
        f'    <geom type="box" pos="{block.x} {block.y} {block.height / 2}" euler="0 0 {block.yaw}" '
        f'size="{block.length / 2} {block.width / 2} {block.height / 2}" rgba="{_COLORS[kind]}"/>'
    )


def _wedge(ramp: Ramp) -> str:
    """Corners in the ramp frame. MuJoCo moves a mesh's origin to its centre of mass, see `MujocoWorld.model`."""
    x, y = ramp.length / 2, ramp.width / 2
    corners = [(-x, -y, 0), (-x, y, 0), (x, -y, 0), (x, y, 0), (x, -y, ramp.height), (x, y, ramp.height)]
    return "  ".join(" ".join(str(value) for value in corner) for corner in corners)


class MujocoWorld:
    """A compiled arena for ray casting and images.

    Raises:
        InputError: if MuJoCo is not installed.
    """

    def __init__(self, arena: Arena):
        self.arena = arena
        self._mujoco = _import_mujoco()
        self.model = self._mujoco.MjModel.from_xml_string(mjcf(arena))
        self.data = self._mujoco.MjData(self.model)
        self._mujoco.mj_forward(self.model, self.data)

    def ranges(self, origin, directions: np.ndarray, max_range: float) -> np.ndarray:
        """Distances to the first hits of rays from one point.

        Args:
            origin: (x, y, z), m.
            directions: [n, 3], length 1.
            max_range: farther hits are ignored, m.

        Returns:
            float64 [n], m; inf for a ray without a hit.
        """
        directions = np.ascontiguousarray(directions, float)
        n = len(directions)
        distance, geom = np.empty(n), np.empty(n, np.int32)
        self._mujoco.mj_multiRay(
            self.model, self.data, np.asarray(origin, float), directions.reshape(-1), None, True, -1, geom, distance,
            None, n, max_range,
        )  # fmt: skip
        return np.where((geom < 0) | (distance < 0) | (distance > max_range), np.inf, distance)

    def picture(
        self,
        width: int = 900,
        height: int = 700,
        azimuth: float = math.pi / 2,
        elevation: float = math.radians(-55),
        distance: float | None = None,
    ) -> np.ndarray:
        """Renders the whole arena, uint8 [height, width, 3].

        Args:
            width, height: in pixels, up to 2000.
            azimuth: camera direction, rad; pi / 2 looks along y.
            elevation: elevation of the line of sight, rad; -pi / 2 looks straight down.
            distance: distance to the middle of the arena, m; None = the whole arena fits.

        Raises:
            InputError: if this machine cannot render: EGL is missing, or the backend in MUJOCO_GL does not work.
        """
        camera = self._mujoco.MjvCamera()
        camera.lookat[:] = self.arena.size / 2, self.arena.size / 2, 0.0
        camera.azimuth, camera.elevation = math.degrees(azimuth), math.degrees(elevation)
        camera.distance = distance or 1.32 * self.arena.size
        try:
            with self._mujoco.Renderer(self.model, height, width) as renderer:
                renderer.update_scene(self.data, camera)
                return renderer.render().copy()
        except (ImportError, AttributeError, RuntimeError, self._mujoco.FatalError) as error:
            raise InputError(
                f"MuJoCo cannot draw here ({error}); try another MUJOCO_GL: egl, osmesa or glfw"
            ) from error


def is_available() -> tuple[bool, str]:
    """Whether MuJoCo is installed, and otherwise the reason and the way to install it."""
    try:
        _import_mujoco()
    except InputError as error:
        return False, str(error)
    return True, ""


def _import_mujoco():
    # MuJoCo reads the variable on import. EGL renders without a display, in software if necessary.
    os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError as error:
        raise InputError(
            f"simulation needs MuJoCo ({error}); install it with: pip install 'hdsp[simulation]'"
        ) from None
    return mujoco
