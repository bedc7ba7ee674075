"""A drive as GIF or MP4, with pictures by MuJoCo.

The camera looks at the robot from its right and from above, and follows it. Legs are drawn with knees, as in
`hdsp.viz.viewer.robot_pose`; the simulated legs are slides. Bars over the wheels show the ground forces.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.detailed.motion.motion_files import ANIMATIONS
from hdsp.detailed.motion.phases import PHASES
from hdsp.planning.driving.simulated_robot import SimulatedRobot, import_mujoco
from hdsp.viz.viewer.robot_pose import parts

_SHOWN = 12.0  # s; a film without a given speed lasts no longer
_SIDE, _ELEVATION = 25.0, -18.0  # degrees, of the view against the way of the robot, and over the horizon
_SMOOTH = 1.0  # s, of the camera's way
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
        fps: pictures per second.
        width, height: size in pixels, even.

    Raises:
        InputError: another suffix, a value out of range, a path that cannot be written, a missing extra, or no
            rendering on this machine.
    """
    path = writable_file(path, "animation", ANIMATIONS)
    speed = max(1.0, run.duration / _SHOWN) if speed is None else speed
    if not (0 < speed <= 1000 and 0 < fps <= 100 and 64 <= width <= 1920 and 64 <= height <= 1440):
        raise InputError(
            f"speed {speed:g}, fps {fps:g}, width {width}, height {height}; need up to 1000, up to 100, 64 to 1920, "
            "64 to 1440"
        )
    try:
        from hdsp.viz.recordings.animation import write_frames
    except ModuleNotFoundError as error:
        raise InputError("animations need Pillow: pip install 'hdsp[record]'") from error
    return write_frames(path, _pictures(run, speed, fps, (width, height)), fps)


def _pictures(run: Any, speed: float, fps: float, size: tuple[int, int]) -> Iterator[Any]:
    from PIL import Image

    mujoco = import_mujoco()
    sim = SimulatedRobot(run.motion.robot, run.ground)
    camera = mujoco.MjvCamera()
    places = _smoothed(run)
    first, last = run.motion.base[[0, -1]]
    way = last[:2] - first[:2]
    along = np.degrees(np.arctan2(way[1], way[0]) if np.linalg.norm(way) > 0.3 else first[5])
    camera.azimuth, camera.elevation = along + 90.0 - _SIDE, _ELEVATION
    camera.distance = 4.6 * max(run.motion.robot.stance.base_height, run.motion.robot.feet.neutral_x)
    rows = np.arange(0.0, run.duration, speed / fps) / max(run.duration, 1e-9) * (len(run.motion) - 1)
    try:
        with mujoco.Renderer(sim.model, size[1], size[0]) as renderer:
            for row in np.append(rows, len(run.motion) - 1).astype(int).tolist():
                sim.data.qpos[:] = run.positions[row]
                mujoco.mj_forward(sim.model, sim.data)
                camera.lookat[:] = places[row]
                renderer.update_scene(sim.data, camera)
                _draw_extras(mujoco, renderer.scene, run, row)
                picture = Image.fromarray(renderer.render())
                _label(picture, run, row, speed)
                yield picture
    except (ImportError, AttributeError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot draw here ({error}); try another MUJOCO_GL: egl, osmesa or glfw") from error


def _smoothed(run: Any) -> np.ndarray:
    """Way of the camera's target, float64 [n, 3], without the robot's sway."""
    from scipy.ndimage import gaussian_filter1d

    step = run.motion.moments[1] - run.motion.moments[0] if len(run.motion) > 1 else 1.0
    places = gaussian_filter1d(run.motion.base[:, :3], _SMOOTH / step, axis=0, mode="nearest")
    return places - (0.0, 0.0, 0.4 * run.motion.robot.stance.base_height)


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
