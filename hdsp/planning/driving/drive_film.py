"""A drive as GIF or MP4, with pictures by MuJoCo.

The camera looks at the robot from its right and from above, and follows it. Between walls, which are drawn as glass, it
looks from behind and from higher up. Legs are drawn with knees, as in
`hdsp.viz.viewer.robot_pose`; the simulated legs are slides. Bars over the wheels show the ground forces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.detailed.motion.local_motion import relative
from hdsp.detailed.motion.motion_files import ANIMATIONS
from hdsp.detailed.motion.phases import PHASES
from hdsp.planning.driving.simulated_robot import SimulatedRobot, import_mujoco
from hdsp.viz.recordings.film_settings import FilmSettings, side
from hdsp.viz.viewer.robot_pose import parts

_LARGEST = 1920, 1440  # pixels
_SIDE, _ELEVATION = 25.0, -18.0  # degrees, of the view against the way of the robot, and over the horizon
_BEHIND, _HIGH = -20.0, -42.0  # degrees, the same between walls, against the heading
_WALL = 0.5  # m, above the highest foothold
_GLASS = 0.3  # opacity
_SMOOTH, _SMOOTH_TURN = 1.0, 2.5  # s, of the camera's way and direction
_LINK = np.array([0.68, 0.71, 0.75, 1.0])
_FORCE = np.array([0.0, 0.62, 0.45, 0.9])


def save_film(
    run: Any, path: str | Path, speed: float | None = None, fps: float = 12.5, width: int = 640, height: int = 420
) -> Path:
    """Writes a drive as an animation, whole or not at all.

    Args:
        run: the drive, a `hdsp.planning.driving.driven_run.Run`.
        path: ``.gif`` or ``.mp4``.
        speed: simulated seconds per animation second; None: at least 1, at most 12 s in all.
        fps: pictures per second, 0.1 to 100.
        width, height: size in pixels, even, 64 to 1920 and 64 to 1440.

    Raises:
        InputError: another suffix, a value out of range, too many pictures, a path that cannot be written, a missing
            extra, or no rendering on this machine.
    """
    path = writable_file(path, "animation", ANIMATIONS)
    size = side("width", width, _LARGEST[0]), side("height", height, _LARGEST[1])
    speed, fps = FilmSettings.of(run.duration, speed, fps)
    try:
        from hdsp.viz.recordings.animation import write_frames
    except ModuleNotFoundError as error:
        raise InputError("animations need Pillow: pip install 'hdsp[record]'") from error
    moments = np.arange(0.0, run.duration, speed / fps) / max(run.duration, 1e-9) * (len(run.motion) - 1)
    rows = np.append(moments, len(run.motion) - 1).astype(int)
    return write_frames(path, lambda numbers: pictures(run, rows[list(numbers)].tolist(), size, speed), len(rows), fps)


def pictures(run: Any, rows: Sequence[int], size: tuple[int, int], speed: float = 1.0) -> Iterator[Any]:
    """Draws states of a drive as Pillow images.

    Args:
        run: the drive.
        rows: numbers of the states.
        size: width and height, pixels.
        speed: simulated seconds per second, for the label.

    Raises:
        InputError: no rendering on this machine.
    """
    from PIL import Image

    mujoco = import_mujoco()
    sim = SimulatedRobot(run.motion.robot, run.ground, run.place)
    run = replace(run, motion=relative(run.motion, run.place))
    camera = mujoco.MjvCamera()
    places = _smoothed(run)
    walls = glass_walls(sim, run)
    directions, camera.elevation = _directions(run, walls)
    camera.distance = 4.6 * max(run.motion.robot.stance.base_height, run.motion.robot.feet.neutral_x)
    try:
        with mujoco.Renderer(sim.model, size[1], size[0]) as renderer:
            for row in rows:
                sim.data.qpos[:] = run.positions[row]
                mujoco.mj_forward(sim.model, sim.data)
                camera.lookat[:], camera.azimuth = places[row], directions[row]
                renderer.update_scene(sim.data, camera)
                renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = not walls  # large shadows are coarse
                _draw_extras(mujoco, renderer.scene, run, row)
                picture = Image.fromarray(renderer.render())
                _label(picture, run, row, speed)
                yield picture
    except (ImportError, AttributeError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot draw here ({error}); try another MUJOCO_GL: egl, osmesa or glfw") from error


def glass_walls(sim: SimulatedRobot, run: Any) -> bool:
    """Turns walls to glass; returns whether there are any."""
    mujoco, model = import_mujoco(), sim.model
    boxes = (model.geom_bodyid == 0) & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    tops = model.geom_pos[:, 2] + model.geom_size[:, 2]
    walls = boxes & (tops > run.motion.feet[..., 2].max() + _WALL)
    model.geom_rgba[walls, 3] = _GLASS
    return bool(walls.any())


def _directions(run: Any, walls: bool) -> tuple[np.ndarray, float]:
    """Azimuths of the view in each state, float64 [n], and its elevation, degrees."""
    if walls:
        return np.degrees(_filtered(run, np.unwrap(run.motion.base[:, 5]), _SMOOTH_TURN)) - _BEHIND, _HIGH
    first, last = run.motion.base[[0, -1]]
    way = last[:2] - first[:2]
    along = np.degrees(np.arctan2(way[1], way[0]) if np.linalg.norm(way) > 0.3 else first[5])
    return np.full(len(run.motion), along + 90.0 - _SIDE), _ELEVATION


def _smoothed(run: Any) -> np.ndarray:
    """Way of the camera's target, float64 [n, 3], without the robot's sway."""
    return _filtered(run, run.motion.base[:, :3], _SMOOTH) - (0.0, 0.0, 0.4 * run.motion.robot.stance.base_height)


def _filtered(run: Any, values: np.ndarray, seconds: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    step = run.motion.moments[1] - run.motion.moments[0] if len(run.motion) > 1 else 1.0
    return gaussian_filter1d(values, seconds / step, axis=0, mode="nearest")


def _draw_extras(mujoco: Any, scene: Any, run: Any, row: int) -> None:
    """Adds links of the legs, and bars for ground forces."""
    robot, base, feet = run.motion.robot, run.motion.base[row], run.motion.feet[row]
    upright = feet.copy()
    found = parts(robot, base, upright)
    hips = base[:3] + robot.hips() @ run.motion.rotations()[row].T
    weight = float(np.linalg.norm(run.forces[row], axis=1).sum()) or 1.0
    for foot in range(4):
        wheel = found.wheels[foot, :3]
        knee = 2 * found.links[foot, 0, :3] - hips[foot]
        for start, end, wide in ((hips[foot], knee, 0.028), (knee, wheel, 0.02)):
            _connect(mujoco, scene, start, end, wide, _LINK)
        push = run.forces[row, foot]
        if np.linalg.norm(push) > 0.02 * weight:
            tip = feet[foot] + 0.6 * push / weight
            _connect(mujoco, scene, feet[foot], tip, 0.012, _FORCE)


def _connect(mujoco: Any, scene: Any, start: np.ndarray, end: np.ndarray, radius: float, color: np.ndarray) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.zeros(9), color.astype(np.float32)
    )
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
    scene.ngeom += 1


def _label(picture: Any, run: Any, row: int, speed: float) -> None:
    from PIL import ImageDraw, ImageFont

    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(max(picture.width // 44, 10))
    words = f"{run.motion.moments[row]:5.1f} s" + (f"   {speed:.3g} x" if speed > 1.01 else "")
    words += f"   {PHASES[run.motion.phase[row]]}"
    if row == len(run.motion) - 1:
        words += f"   {run.cause}"
    edge = picture.width // 60
    draw.text((edge, edge), words, fill="#202020", font=font)
