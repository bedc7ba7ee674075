"""The robot behind labels, as far as shards and indices of labels record it."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.storage import Place, is_folder
from hdsp.labels.shard_index import ShardIndex
from hdsp.labels.shards import index_of, read_attributes, read_shard, shard_paths
from hdsp.labels.tasks import TaskSet
from hdsp.robot.robot import Robot

#: Attribute of shards with ``Robot.hash()``, where no `labels_inputs` name the robot.
ROBOT_HASH = "robot_hash"


class OtherRobotError(InputError):
    """Raised if labels belong to another robot than they should."""


def other_robot(place: Place, robot: Robot) -> str:
    """Returns why labels do not belong to a robot: the first place with those of another one.

    Args:
        place: shard, or a folder as for `hdsp.labels.shards.shard_paths`.
        robot: the robot that the labels have to belong to.

    Returns:
        Words about the labels; empty if they belong to the robot, or record none.

    Raises:
        InputError: a shard or an index is damaged.
    """
    index = index_of(place) if is_folder(place) else None
    if index is not None:
        return _words(place, robot) if _is_other(_of_index(index), robot) else ""
    others = (path for path in shard_paths(place) if is_of_other_robot(read_attributes(path), robot))
    return next((_words(path, robot) for path in others), "")


def read_own_tasks(place: Place, robot: Robot | None, paths: Sequence[Place] | None = None) -> list[TaskSet]:
    """Reads the tasks in each shard at a place, and compares their robot in the same pass.

    Args:
        place: as for `other_robot`.
        robot: the robot to which the labels have to belong, unless they record none; None = any labels.
        paths: shards to read; None = all.

    Raises:
        OtherRobotError: the labels are of another robot.
        InputError: a shard or an index is damaged.
    """
    index = index_of(place) if is_folder(place) else None
    if robot is not None and index is not None and _is_other(_of_index(index), robot):
        raise OtherRobotError(_words(place, robot))
    sets = []
    for path in shard_paths(place) if paths is None else paths:
        tasks, attributes = read_shard(path)
        if robot is not None and index is None and is_of_other_robot(attributes, robot):
            raise OtherRobotError(_words(path, robot))
        sets.append(tasks)
    return sets


def is_of_other_robot(attributes: Mapping[str, Any], robot: Robot) -> bool:
    """Returns whether a shard with these attributes records another robot."""
    found = attributes.get(ROBOT_HASH)
    if found is None and isinstance(text := attributes.get("labels_inputs"), str):
        try:
            found = json.loads(text).get("robot")
        except (ValueError, AttributeError):  # written by another program
            found = None
    return _is_other(found, robot)


def _of_index(index: ShardIndex) -> Any:
    return index.inputs.get("robot") if isinstance(index.inputs, Mapping) else None


def _is_other(found: Any, robot: Robot) -> bool:
    """Whether a recorded robot, a hash or all of its values, is another one."""
    if not isinstance(found, Mapping):
        return found not in (None, robot.hash())
    try:
        return Robot.load(dict(found)).hash() != robot.hash()
    except InputError:  # recorded with other keys than those of robots now
        return found.get("name") not in (None, robot.name)


def _words(place: Place, robot: Robot) -> str:
    return f"the labels in {place} are of another robot than {robot.name} as it is now"
