"""A motion as an animation: GIF by Pillow, MP4 by imageio-ffmpeg.

The camera looks from the right and from above, without perspective. Wheels in the air are orange, and the shadow lies
below the robot.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import replacing, writable_file
from hdsp.detailed.motion.local_motion import local_place, relative
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_files import ANIMATIONS
from hdsp.detailed.motion.phases import PHASES
from hdsp.robot.robot import FEET
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import BLUE, UNKNOWN, VERMILLION
from hdsp.viz.palette import FEET as FOOT_COLORS
from hdsp.viz.recordings.film_settings import FilmSettings, side
from hdsp.viz.recordings.robot_mesh import RobotMesh
from hdsp.viz.recordings.track import Track
from hdsp.viz.recordings.z_buffer import Canvas, ParallelCamera, Triangles
from hdsp.viz.viewer.ground_mesh import ground_mesh, surface_of
from hdsp.viz.viewer.textures import height_colors, rgb

_WIDEST = 3840  # pixels
_AROUND = 0.55  # m, of ground beyond the feet
_LIGHT = np.array([-0.35, -0.6, 1.0])
_FINE = 2  # each pixel is the mean over so many by so many
_SHADOW = 0.62
_LONG, _TALL = 0.35, 0.25  # m, of the robot around and above the middle of its hips, for the size of the picture
_FLOOR = 0.06  # m, thickness of the ground at its lowest
_SIDE = np.radians(35)  # direction of view against the way of the robot, seen from its right
_ELEVATION = np.radians(28)
_WORDS = {
    "roll": "rolls on four wheels", "lean": "shifts its weight", "lift": "lifts the {} foot",
    "swing": "swings the {} foot", "lower": "lowers the {} foot",
}  # fmt: skip
_INSIDE = 1e-3  # m, from a surface into the ground
_MOST_PIXELS = 1_000_000_000  # in a GIF
_COLORS, _STRIP = 112, 90  # colours in a GIF; rows of pixels
_STRENGTH = 0.62  # of the colours of heights


def save_animation(
    motion: Motion, path: str | os.PathLike, speed: float | None = None, fps: float = 12.5, width: int = 720
) -> Path:
    """Writes a motion as an animation in three dimensions, whole or not at all.

    Args:
        motion: the motion.
        path: ``.gif`` or ``.mp4``.
        speed: motion seconds per animation second; None: at least 1, at most 12 s in all.
        fps: pictures per second.
        width: width, pixels; the height follows from the motion.

    Raises:
        InputError: another suffix, a value out of range, more pictures than 10,000 or than fit into a GIF, a path that
            cannot be written, or a missing extra.
    """
    path = writable_file(path, "animation", ANIMATIONS)
    columns, chosen = side("width", width, _WIDEST), FilmSettings.of(motion.duration, speed, fps)
    film = _Film(relative(motion, local_place(motion.terrain)), chosen, columns)
    return write_frames(path, film.frames, len(film), chosen.fps)


def write_frames(path: Path, draw: Callable[[Sequence[int]], Iterator[Any]], count: int, fps: float) -> Path:
    """Writes an animation, whole or not at all.

    Args:
        path: ``.gif`` or ``.mp4``.
        draw: yields the pictures with these numbers, Pillow images of one size.
        count: number of pictures.
        fps: pictures per second.

    Returns:
        the path.

    Raises:
        InputError: a path that cannot be written, a missing extra, or a GIF beyond all memory.
    """
    with replacing(path) as temporary:
        (_write_gif if path.suffix.lower() == ".gif" else _write_mp4)(temporary, draw, count, fps)
    return path


class _Film:
    """A motion's pictures."""

    def __init__(self, motion: Motion, settings: FilmSettings, width: int):
        self._track = Track(motion, settings.fps / settings.speed)
        self._mesh, self._speed = RobotMesh(self._track), settings.speed
        self._ground = _crop(motion)
        self._scene = self._empty(width)
        self._ground_at = self._scene.camera.world(self._scene.depth)[..., :2]

    def __len__(self) -> int:
        return len(self._track)

    def frames(self, numbers: Sequence[int]) -> Iterator[Any]:
        """Yields pictures, Pillow images."""
        from PIL import Image

        width, height = (side // _FINE for side in self._scene.camera.size)
        for k in numbers:
            robot = self._mesh.at(k)
            canvas = self._scene.copy()
            canvas.pixels[self._shaded(robot)] *= _SHADOW
            canvas.draw(robot, _LIGHT)
            picture = Image.fromarray((np.clip(canvas.pixels, 0, 1) * 255).astype(np.uint8))
            picture = picture.resize((width, height), Image.Resampling.BOX)
            self._label(picture, k)
            yield picture

    def _empty(self, width: int) -> Canvas:
        """The ground without the robot."""
        track, terrain = self._track, self._ground
        (x, y), (length, across) = terrain.origin, terrain.size
        surface = surface_of(terrain)
        heights = surface.heights.astype(float)
        low, (first, last) = float(heights.min()), track.state.base[[0, -1], :2]
        along = np.arctan2(*(last - first)[::-1]) if np.linalg.norm(last - first) > 0.1 else track.state.base[0, 5]
        rim = np.array([(x + i * length, y + j * across, heights[-i, -j]) for i in (0, 1) for j in (0, 1)])
        reach = np.array([(dx, dy, _TALL) for dx in (-_LONG, _LONG) for dy in (-_LONG, _LONG)])
        robot = (track.state.base[:, None, :3] + reach).reshape(-1, 3)
        fitted = np.concatenate([rim, rim * (1, 1, 0) + (0, 0, low - _FLOOR), robot])
        camera = ParallelCamera(float(along + np.pi / 2 - _SIDE), float(_ELEVATION), fitted, _FINE * width)
        canvas = Canvas(camera)
        mesh = ground_mesh(surface)
        corners = mesh.vertices[mesh.faces.astype(int)].astype(float)
        canvas.draw(Triangles(np.concatenate([corners, _sides(terrain, heights, low - _FLOOR)]),
                              np.full((len(corners) + 4 * sum(terrain.shape), 3), 0.93)), _LIGHT)  # fmt: skip
        self._paint(canvas)
        return canvas

    def _paint(self, canvas: Canvas) -> None:
        """Colours the ground by its height."""
        terrain = self._ground
        seen = np.isfinite(canvas.depth)
        place = canvas.camera.world(canvas.depth + _INSIDE)[..., :2]  # a wall has the colour of the cell behind it
        cell = np.floor((place - terrain.origin) / terrain.resolution).astype(int)
        cell = np.clip(cell, 0, np.array(terrain.shape) - 1)[seen]
        colors = 1 - _STRENGTH * (1 - height_colors(terrain)[..., :3] / 255.0)
        colors[np.isnan(terrain.heights)] = np.array(rgb(UNKNOWN)) / 255
        canvas.pixels[seen] *= colors[cell[:, 0], cell[:, 1]]

    def _shaded(self, robot: Triangles) -> np.ndarray:
        """Ground pixels below the robot, bool [rows, columns]."""
        above = ParallelCamera(np.pi / 2, np.pi / 2, robot.corners.reshape(-1, 3), 200)
        shade = Canvas(above)
        shade.draw(robot, _LIGHT)
        covered = np.isfinite(shade.depth)
        at = above.see(np.concatenate([self._ground_at, np.zeros((*self._ground_at.shape[:2], 1))], axis=-1))
        column, row = np.floor(at[..., 0]).astype(int), np.floor(at[..., 1]).astype(int)
        inside = (column >= 0) & (row >= 0) & (column < covered.shape[1]) & (row < covered.shape[0])
        inside &= np.isfinite(self._scene.depth)
        inside[inside] = covered[row[inside], column[inside]]
        return inside

    def _label(self, picture: Any, k: int) -> None:
        from PIL import ImageDraw, ImageFont

        state, draw = self._track.state, ImageDraw.Draw(picture)
        font = ImageFont.load_default(max(picture.width // 48, 10))
        words = _WORDS[PHASES[state.phase[k]]]
        if not state.carries[k].all():
            words = words.format(FEET[int(np.argmin(state.carries[k]))].replace("_", " "))
        edge, line = picture.width // 60, picture.width // 36
        draw.text((edge, edge), words, fill="#202020", font=font)
        times = f"{state.time[k]:5.1f} s" + (f"   {self._speed:.3g} x" if self._speed > 1.01 else "")
        draw.text((edge, edge + line), times, fill="#707070", font=font)
        share = state.time[k] / max(state.time[-1], 1e-9)
        draw.rectangle((0, picture.height - 3, round(share * picture.width), picture.height), fill=BLUE)


def _crop(motion: Motion) -> HeightMap:
    """Ground around the motion."""
    terrain = motion.terrain
    places = motion.feet[..., :2].reshape(-1, 2)
    low = np.floor((places.min(axis=0) - _AROUND - terrain.origin) / terrain.resolution).astype(int)
    high = np.ceil((places.max(axis=0) + _AROUND - terrain.origin) / terrain.resolution).astype(int)
    (left, front), (right, back) = np.maximum(low, 0), np.minimum(high, terrain.shape)
    origin = (
        terrain.origin[0] + float(left) * terrain.resolution, terrain.origin[1] + float(front) * terrain.resolution,
    )  # fmt: skip
    return HeightMap(terrain.heights[left:right, front:back], origin, terrain.resolution)


def _sides(terrain: HeightMap, heights: np.ndarray, floor: float) -> np.ndarray:
    """Triangles from the map's rim down to a floor, as if it were cut out, float64 [4 (nx + ny), 3, 3]."""
    (x0, y0), (length, across), cell = terrain.origin, terrain.size, terrain.resolution
    quads = []
    for count, rim, start, step in (
        (terrain.shape[0], heights[:, 0], (x0, y0), (cell, 0.0)),
        (terrain.shape[0], heights[::-1, -1], (x0 + length, y0 + across), (-cell, 0.0)),
        (terrain.shape[1], heights[-1], (x0 + length, y0), (0.0, cell)),
        (terrain.shape[1], heights[0, ::-1], (x0, y0 + across), (0.0, -cell)),
    ):
        first = np.array(start) + np.arange(count)[:, None] * step
        second = first + step
        low = np.full((count, 1), floor)
        top = rim[:, None]
        a, b = np.hstack([first, low]), np.hstack([second, low])
        c, d = np.hstack([second, top]), np.hstack([first, top])
        quads += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return np.concatenate(quads)


def _write_gif(path: Path, draw: Callable[[Sequence[int]], Iterator[Any]], count: int, fps: float) -> None:
    from PIL import Image

    # One palette for all pictures: pixels that do not change stay equal, and cost nothing. Wheels are too small to
    # count among the colours of a picture, so the sample has theirs in a strip.
    samples = list(draw((0, count // 2, count - 1)))
    width, height = samples[0].size
    if count * width * height > _MOST_PIXELS:  # Pillow holds them all
        need = f"at most {_MOST_PIXELS:,} pixels in all, by a higher speed or a lower fps or width, or .mp4"
        raise InputError(f"GIF: {count:,} pictures of {width} x {height} pixels; need {need}")
    sample = Image.new("RGB", (width, 3 * height + _STRIP))
    for number, picture in enumerate(samples):
        sample.paste(picture, (0, number * height))
    small = [
        tuple(round(shade * part) for part in rgb(c)) for c in (*FOOT_COLORS, VERMILLION) for shade in (1, 0.8, 0.6)
    ]
    for number, color in enumerate(small):
        ends = [width * k // len(small) for k in (number, number + 1)]
        sample.paste(color, (ends[0], 3 * height, ends[1], 3 * height + _STRIP))
    palette = sample.quantize(_COLORS, method=Image.Quantize.MEDIANCUT)
    drawn = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in draw(range(count))]
    lengths = [round(1000 / fps)] * (len(drawn) - 1) + [1500]
    drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=lengths, loop=0, optimize=True, disposal=1)


def _write_mp4(path: Path, draw: Callable[[Sequence[int]], Iterator[Any]], count: int, fps: float) -> None:
    try:
        from imageio_ffmpeg import write_frames
    except ModuleNotFoundError as error:
        raise InputError("animations as MP4 need imageio-ffmpeg: pip install 'hdsp[video]'") from error
    frames = draw(range(count))
    first = next(frames)
    size = first.width - first.width % 2, first.height - first.height % 2
    box = (0, 0, *size)
    writer = write_frames(str(path), size, fps=fps, macro_block_size=2, quality=7, ffmpeg_log_level="error")
    writer.send(None)
    try:
        for picture in (first, *frames):
            writer.send(np.ascontiguousarray(picture.crop(box)))
    finally:
        writer.close()
