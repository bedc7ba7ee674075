"""Motions as files: tables (CSV), JSON and archives (NPZ); higher packages register further formats.

Convention: metres, radians and seconds. Poses are in the map frame. If the map's frame is not its source's, CSV
and JSON also hold the base poses in the source frame, with the names in ``SOURCE_COLUMNS``.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.array_files import npz_arrays
from hdsp.base.errors import InputError
from hdsp.base.files import as_path, existing_file, replacing, writable_file
from hdsp.base.messages import coordinates, shown, spans
from hdsp.base.scalars import real
from hdsp.detailed.motion.motion_state import MotionState
from hdsp.detailed.motion.phases import PHASES
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap, as_height_map
from hdsp.terrain.map_frame import MapFrame

#: Writes a motion to a path, with so many states per second.
MotionWriter = Callable[[Any, Path, float], object]

#: Name and version of the format in JSON files and archives.
FORMAT, VERSION = "hdsp motion", 1
#: Suffixes of animations.
ANIMATIONS = (".gif", ".mp4")
SOURCE_COLUMNS = ("source_x", "source_y", "source_z", "source_qx", "source_qy", "source_qz", "source_qw")
_BASE = ("x", "y", "z", "roll", "pitch", "heading")
#: Arrays of a motion: their types, and their shapes behind the number of configurations.
_KINDS = {"base": float, "feet": float, "carries": bool, "action": np.int64, "phase": np.uint8}
_SHAPES = {"base": (6,), "feet": (4, 3), "carries": (4,), "action": (), "phase": ()}
_ARRAYS = tuple(_KINDS)
_MOST_BYTES = 1 << 30
_MOST_STATES = 5_000_000
_DIGITS = 6


def save_motion_file(motion: Any, path: str | os.PathLike, rate: float) -> Path:
    """Writes a motion; see ``Motion.save``."""
    path = check_motion_path(path)
    if not 0 < real(rate) <= 10_000:
        raise InputError(f"rate is {shown(rate)}; need a positive number of states per second, at most 10,000")
    if path.suffix.lower() not in ANIMATIONS and motion.duration * real(rate) > _MOST_STATES:
        count = f"{motion.duration * real(rate):,.0f} states in {motion.duration:,.0f} s"
        raise InputError(f"rate is {shown(rate)}: {count}; need at most {_MOST_STATES:,}, by a lower rate")
    _WRITERS[path.suffix.lower()](motion, path, real(rate))
    return path


def check_motion_path(path: str | os.PathLike) -> Path:
    """Returns ``path`` as a Path after a check that a motion can be written there.

    Raises:
        InputError: an unknown suffix, a place that cannot be written to, or a folder that exists for a ROS 2 bag.
    """
    path = as_path(path, "motion")
    known = sorted(suffix for suffix in _WRITERS if suffix)
    if path.suffix.lower() not in _WRITERS:
        raise InputError(
            f"motion {path}: suffix {path.suffix!r}; need one of {', '.join(known)}, or none for a ROS 2 bag"
        )
    if path.suffix:
        return writable_file(path, "motion", known)
    if os.path.exists(path):
        raise InputError(f"ROS 2 bag {path}: exists already; need a new folder")
    return writable_file(path, "ROS 2 bag")


def animate_motion(motion: Any, path: str | os.PathLike, **look: float | None) -> Path:
    """Writes an animation; see ``Motion.animate``."""
    if not _ANIMATORS:
        raise InputError("animations need hdsp.viz.recordings.recording_formats; import it first")
    return _ANIMATORS[-1](motion, Path(path), **look)


def register_animator(animator: Callable[..., Path]) -> None:
    """Registers the animation maker, called with a motion, a path, and `speed`, `fps` and `width`."""
    _ANIMATORS.append(animator)
    for suffix in ANIMATIONS:
        register_motion_writer(suffix, lambda motion, path, rate: animate_motion(motion, path))


def register_motion_writer(suffix: str, writer: MotionWriter) -> None:
    """Registers a format by its suffix in small letters; empty for a folder."""
    _WRITERS[suffix] = writer


def sample_times(motion: Any, rate: float) -> np.ndarray:
    """Returns regular times from the start, float64 [n], s; the end is the last one."""
    times = np.arange(np.floor(motion.duration * rate - 1e-6) + 1) / rate
    return np.append(times, motion.duration) if motion.duration else np.zeros(1)


def source_base(motion: Any, base: np.ndarray) -> np.ndarray:
    """Returns base poses [n, 6] in the source frame, float64 [n, 7]: x, y, z and a quaternion x, y, z, w."""
    from scipy.spatial.transform import Rotation

    frame = motion.terrain.frame
    turned = Rotation.from_matrix(frame.to_source[:3, :3]) * Rotation.from_euler("ZYX", base[:, [5, 4, 3]])
    return np.concatenate([frame.points_to_source(base[:, :3]), turned.as_quat(canonical=True)], axis=1)


def map_frame_name(frame: MapFrame) -> str:
    """Returns the map frame's name in files: its source's name if both are the same, else ``map``."""
    if frame.is_source and frame.name:
        return frame.name
    return "level_map" if frame.name == "map" else "map"


def frame_facts(frame: MapFrame) -> dict[str, Any]:
    """Returns the frames for a file: the map's name, its source, and the rigid motion between them."""
    return {
        "name": map_frame_name(frame),
        "source": frame.name,
        "crs": frame.crs,
        "to_source": frame.to_source.tolist(),
        "notes": list(frame.notes),
    }


def _write_csv(motion: Any, path: Path, rate: float) -> None:
    state = motion.at(sample_times(motion, rate))
    n = len(state.time)
    names = ["time", *_BASE, *(f"v_{name}" for name in _BASE)]
    names += [f"{foot}_{axis}" for foot in FEET for axis in "xyz"] + ["margin"]
    values = [state.time[:, None], state.base, state.base_velocity, state.feet.reshape(n, 12), state.margin[:, None]]
    frame = motion.terrain.frame
    if not frame.is_source:
        names += SOURCE_COLUMNS
        values.append(source_base(motion, state.base))
    contacts = [f"{foot}_contact" for foot in FEET]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*names, *contacts, "action", "phase", "frame", "source_frame"])
        whole = np.concatenate(values, axis=1).tolist()
        flags, actions, phases = state.carries.astype(int).tolist(), state.action.tolist(), state.phase.tolist()
        for row, carries, action, phase in zip(whole, flags, actions, phases, strict=True):
            numbers = [f"{value:.{_DIGITS}f}" for value in row]
            table.writerow([*numbers, *carries, action, PHASES[phase], map_frame_name(frame), frame.name])


def _write_json(motion: Any, path: Path, rate: float) -> None:
    state = motion.at(sample_times(motion, rate))
    states = {name: _plain(getattr(state, name)) for name in MotionState.__dataclass_fields__}
    if not motion.terrain.frame.is_source:
        states["source"] = _plain(source_base(motion, state.base))
    document = {
        "format": FORMAT,
        "version": VERSION,
        "robot": motion.robot.name,
        "frame": frame_facts(motion.terrain.frame),
        "feet": list(FEET),
        "phases": list(PHASES),
        "duration": motion.duration,
        "states": states,
        "configurations": {"times": motion.times.tolist()} | {n: getattr(motion, n).tolist() for n in _ARRAYS},
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _plain(values: np.ndarray) -> list:
    return (np.round(values, _DIGITS) + 0.0 if values.dtype.kind == "f" else values).tolist()


def _write_npz(motion: Any, path: Path, rate: float) -> None:
    terrain = motion.terrain
    facts = {
        "format": FORMAT,
        "version": VERSION,
        "robot": motion.robot.to_dict(),
        "frame": frame_facts(terrain.frame),
        "feet": FEET,
        "phases": PHASES,
    }
    state = motion.at(sample_times(motion, rate))
    arrays = {name: getattr(motion, name) for name in ("times", *_ARRAYS)}
    arrays |= {f"state_{name}": getattr(state, name) for name in MotionState.__dataclass_fields__}
    arrays |= {"heights": terrain.heights, "origin": np.array(terrain.origin), "resolution": terrain.resolution}
    with replacing(path) as temporary:
        np.savez_compressed(temporary, facts=np.array(json.dumps(facts)), **arrays)


def read_motion(path: str | os.PathLike, terrain: Any, robot: Any) -> dict[str, Any]:
    """Returns the motion fields in a file; see ``Motion.load``."""
    path = existing_file(path, "motion")
    try:
        if path.suffix.lower() == ".npz":
            return _checked(path, _read_npz(path))
        if path.suffix.lower() == ".json":
            return _checked(path, _read_json(path, terrain, robot))
    except (KeyError, TypeError, ValueError, OSError, RecursionError, OverflowError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"motion {path}: no motion of hdsp ({' '.join(str(error).split())[:200]})") from error
    raise InputError(f"motion {path}: suffix {path.suffix!r}; need .npz or .json")


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        archive = npz_arrays(path, _MOST_BYTES)
    except InputError as error:
        raise InputError(f"motion {path}: no motion of hdsp ({error})") from error
    facts = json.loads(str(archive["facts"]))
    _check_format(path, facts)
    terrain = HeightMap(
        archive["heights"], tuple(archive["origin"]), float(archive["resolution"]), _frame(facts["frame"])
    )
    return {
        **{name: archive[name] for name in _ARRAYS},
        "terrain": terrain,
        "robot": Robot.load(facts["robot"]),
    }


def _read_json(path: Path, terrain: Any, robot: Any) -> dict[str, Any]:
    document = json.loads(path.read_text(encoding="utf-8"))
    _check_format(path, document)
    if terrain is None:
        raise InputError(f"motion {path}: JSON holds no map; need the argument terrain")
    arrays = {name: np.array(document["configurations"][name], kind) for name, kind in _KINDS.items()}
    if isinstance(terrain, np.ndarray | list | tuple):
        raise InputError(f"motion {path}: terrain is an array; need a HeightMap, or the path of one")
    terrain = as_height_map(terrain)
    for places in (arrays["base"], arrays["feet"]):
        _check_on_map(path, places[..., :2].reshape(-1, 2), terrain)
    return {**arrays, "terrain": terrain, "robot": Robot.load(document["robot"] if robot is None else robot)}


def _check_on_map(path: Path, places: np.ndarray, terrain: HeightMap) -> None:
    """Refuses places [n, 2], m, off a map."""
    low = np.asarray(terrain.origin)
    high = low + terrain.resolution * np.asarray(terrain.shape)
    off = ~((places >= low) & (places < high)).all(axis=1)
    if off.any():
        at = coordinates(places[off.argmax()])
        raise InputError(f"motion {path}: ({at}) m is outside the map, which spans {spans(low, high)} m")


def _checked(path: Path, parts: dict[str, Any]) -> dict[str, Any]:
    """Parts of a motion with arrays of the right shapes, types and ranges."""
    number = len(parts["base"]) if np.ndim(parts["base"]) else 0
    for name, shape in _SHAPES.items():
        array = parts[name]
        if array.shape != (number, *shape) or array.dtype.kind not in "fiub" or number < 1:
            raise InputError(f"motion {path}: {name} is {array.dtype} {list(array.shape)}; need [n, {list(shape)}]")
        if not np.isfinite(array).all():
            raise InputError(f"motion {path}: {name} has values that are not finite")
        parts[name] = array.astype(_KINDS[name])
    if parts["phase"].max() >= len(PHASES):
        raise InputError(f"motion {path}: phase is {parts['phase'].max()}; need less than {len(PHASES)}")
    return parts


def _check_format(path: Path, facts: dict[str, Any]) -> None:
    if (facts.get("format"), facts.get("version")) != (FORMAT, VERSION):
        raise InputError(
            f"motion {path}: format {facts.get('format')!r} {facts.get('version')}; need {FORMAT} {VERSION}"
        )


def _frame(facts: dict[str, Any]) -> MapFrame:
    return MapFrame(facts["source"], facts["crs"], np.array(facts["to_source"]), tuple(facts["notes"]))


_ANIMATORS: list[Callable[..., Path]] = []
_WRITERS: dict[str, MotionWriter] = {".csv": _write_csv, ".json": _write_json, ".npz": _write_npz}
