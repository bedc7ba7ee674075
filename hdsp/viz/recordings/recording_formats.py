"""Formats of recordings for ``Motion.save`` and ``Motion.animate``, which importing this module registers.

foxglove-sdk, rosbags and Pillow load when a file is written.
"""

from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_files import register_animator, register_motion_writer


def _mcap(motion: Motion, path: Path, rate: float) -> None:
    from hdsp.viz.recordings.mcap_recording import write_mcap

    write_mcap(motion, path, rate)


def _ros_bag(motion: Motion, path: Path, rate: float) -> None:
    from hdsp.viz.recordings.ros_bag import write_ros_bag

    write_ros_bag(motion, path, rate)


def _animation(motion: Motion, path: Path, **look: float | None) -> Path:
    try:
        from hdsp.viz.recordings.animation import save_animation
    except ModuleNotFoundError as error:
        raise InputError("animations need Pillow: pip install 'hdsp[record]'") from error
    return save_animation(motion, path, **look)  # type: ignore[arg-type]


register_animator(_animation)
register_motion_writer(".mcap", _mcap)
register_motion_writer("", _ros_bag)
