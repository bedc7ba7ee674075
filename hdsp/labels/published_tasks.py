"""Labels published by the paper's authors: download, reading, and writing in the same format.

The format is text. A header contains the map count. Each map follows: a line with its number; a line with 72 x 72
heights in metres; 22 lines `x y yaw cost` (m, m, rad) in the order of `hdsp.robot.lattice.ABSTRACT_ACTIONS`, where
infeasible tasks have cost `inf`. The robot stands in the middle of the patch with heading 0.

    python -m hdsp.labels.published_tasks export data/labels/random tasks.txt     # shards -> text
    python -m hdsp.labels.published_tasks import tasks.txt data/mine/tasks.h5     # text -> a shard
"""

import argparse
import hashlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hdsp.base.downloads import DATA_DIR_VARIABLE, data_folder, fetch, first_words
from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replacing
from hdsp.base.storage import Place
from hdsp.labels.shards import read_tasks, write_shard
from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    abstract_steps,
    abstract_steps_to_world,
)

COMMIT = "2bedf130c4e8bf3008ace07dc3bde445cd98cf38"
URL = (
    "https://raw.githubusercontent.com/AIS-Bonn/planning_abstraction_net/"
    f"{COMMIT}/data_sets/simulated_test_data_set.txt"
)
SHA256 = "9a1d5bd698b3fab222491e6a822cfc5019c1785c70f2f4cab1b8eb44f98162fe"

#: Paths of the file in a data folder; the whole set comes before the subset with even map numbers.
PLACES = ("published/simulated_test_data_set.txt", "published/simulated_even.txt")

#: `TaskSet.category` for all maps in the file.
CATEGORY = "published"

#: Numbers of flat maps, and of maps with stairs or other edges for stepping; all other maps are for driving.
FLAT_MAPS = frozenset({22, 23, 24})
STAIRS_MAPS = frozenset({44, 45, *range(47, 57)})

#: Axes of the heights in a line, slowest first: height number ``ix * 72 + iy`` belongs to cell ``[ix, iy]``.
AXES = "xy"

_SOLVED = 0  # hdsp.detailed.search.outcome.Status.SOLVED; importing that here would load the planner
_DIGITS = 6


def terrain_kind(number: int) -> str:
    """Kind of map ``number`` in the authors' file: ``flat``, ``stairs`` or ``driving``."""
    return "flat" if number in FLAT_MAPS else "stairs" if number in STAIRS_MAPS else "driving"


def find_published(data_dir: str | os.PathLike | None = None, timeout: float = 30.0) -> tuple[Path | None, str]:
    """Finds the published labels.

    The function looks in ``data_dir``, by default in the folder named by the environment variable HDSP_DATA_DIR. If the
    file is not there, it downloads the file once from its public address to the user's cache and checks its SHA-256.

    Args:
        data_dir: folder with the files in `PLACES`.
        timeout: seconds to wait for the server.

    Returns:
        (path, ""), or (None, reason and the way to get the file).
    """
    folder = data_folder(data_dir)
    if folder:
        for place in PLACES:
            if os.path.isfile(folder / place):
                return folder / place, ""
    try:
        return _fetch(timeout), ""
    except Exception as error:  # no failed download may stop a pipeline that can run without the file
        reason = first_words(error)
    where = f"not in {folder}" if folder else f"{DATA_DIR_VARIABLE} is not set"
    return None, (
        f"published labels: {where} and not fetched from {URL}: {reason}; "
        f"put the file at {PLACES[0]} in a folder and name that folder in {DATA_DIR_VARIABLE}"
    )


def read_published(path: str | os.PathLike) -> TaskSet:
    """Reads a file in the published format; ``index`` is a map's number in the file.

    Raises:
        InputError: if the file is missing, cut off, or has another format; the message names the line.
    """
    path = existing_file(path, "published labels")
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"published labels {path} cannot be read: {error}") from error
    maps = list(_maps(path, lines))
    if not maps:
        return TaskSet.empty()
    index, heights, tasks = (np.array(column) for column in zip(*maps, strict=True))
    heights = heights.reshape(-1, PATCH_CELLS, PATCH_CELLS)
    poses, cost = tasks[:, :, :3], tasks[:, :, 3]
    feasible = np.isfinite(cost)
    return TaskSet(
        heights=heights if AXES == "xy" else heights.swapaxes(1, 2),
        goals=np.broadcast_to(ABSTRACT_ACTIONS, poses.shape),
        feasible=feasible,
        cost=np.where(feasible, cost, 0.0),
        reason=np.where(feasible, _SOLVED, REASON_UNKNOWN),
        category=np.full(len(maps), CATEGORY),
        index=index,
        seed=np.zeros(len(maps)),
        heading=np.zeros(len(maps)),
        start=np.zeros((len(maps), 7)),
        goal=np.concatenate([poses, np.zeros((*poses.shape[:2], 4))], axis=-1),
    )


def write_published(path: str | os.PathLike, tasks: TaskSet) -> Path:
    """Writes tasks in the published format; heights and costs have six decimal places.

    Raises:
        InputError: if a goal differs from its abstract action (at headings other than 0), or the file cannot be
            written.
    """
    if not (tasks.goals == ABSTRACT_ACTIONS).all():
        raise InputError("published format: needs goals equal to the abstract actions, as at heading 0")
    heights = tasks.heights if AXES == "xy" else tasks.heights.swapaxes(1, 2)
    cost = np.where(tasks.feasible, tasks.cost, np.inf)
    with replacing(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write("Abstraction tasks: number of the map | heights | x, y, yaw, cost of each goal\n")
        file.write(f"Num maps:\n{len(tasks)}\n")
        for row in range(len(tasks)):
            poses = abstract_steps_to_world(tasks.goals[row])
            file.write(f"\n{tasks.index[row]}\n{_numbers(heights[row].ravel())}\n")
            file.writelines(f"{_numbers([*pose, value])}\n" for pose, value in zip(poses, cost[row], strict=True))
    return Path(path)


def export_tasks(source: Place, target: str | os.PathLike) -> TaskSet:
    """Writes the tasks in a shard or shard folder (path or URL) as text; returns the tasks.

    Raises:
        InputError: as `hdsp.read_tasks` and `write_published`.
    """
    tasks = read_tasks(source)
    write_published(target, tasks)
    return tasks


def import_tasks(source: str | os.PathLike, target: Place) -> TaskSet:
    """Writes the tasks in a text file as a shard (path or URL); returns the tasks.

    Raises:
        InputError: as `read_published` and `write_shard`.
    """
    tasks = read_published(source)
    checksum = hashlib.sha256(Path(source).read_bytes()).hexdigest()
    write_shard(target, tasks, {"labels_hash": checksum, "source": Path(source).name})
    return tasks


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m hdsp.labels.published_tasks", description="Tasks as text and back."
    )
    parser.add_argument("action", choices=("export", "import"))
    parser.add_argument("source", help="export: a shard, or a folder of shards; import: a text file")
    parser.add_argument("target", help="export: a text file; import: a shard (.h5)")
    arguments = parser.parse_args(argv)
    try:
        move = export_tasks if arguments.action == "export" else import_tasks
        tasks = move(arguments.source, arguments.target)
    except InputError as error:
        sys.exit(f"error: {error}")
    print(f"{len(tasks)} maps, {tasks.feasible.size} tasks: {arguments.source} -> {arguments.target}")


def _fetch(timeout: float) -> Path:
    return fetch(URL, SHA256, Path(PLACES[0]).name, timeout)


def _maps(path: Path, lines: list[str]) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Number, heights [5184] and tasks [22, 4] for each map in the file."""
    filled = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    starts = [k for k, (_, line) in enumerate(filled) if line.strip().lower().startswith("num maps")]
    if not starts:
        raise InputError(f"published labels {path}: no line 'Num maps:'; not a file in the published format")
    rows = iter(filled[starts[0] + 1 :])

    def numbers(count: int, what: str) -> np.ndarray:
        number, line = next(rows, (len(lines), None))
        if line is None:
            raise InputError(f"published labels {path}: ends after line {number} where {what} should follow; cut off?")
        try:
            values = np.array(line.split(), dtype=float)
        except ValueError as error:
            raise InputError(f"published labels {path}, line {number}: {error} in {what}") from None
        if len(values) != count:
            raise InputError(f"published labels {path}, line {number}: {len(values)} numbers; need {count}: {what}")
        return values

    def whole(what: str) -> int:
        value = numbers(1, what)[0]
        if value < 0 or value % 1 != 0:  # NaN as well as a fraction
            raise InputError(f"published labels {path}: {what} is {value}; need a whole number")
        return int(value)

    for position in range(whole("the number of maps")):
        what = f"map {position} of the file"
        index = whole(f"number of {what}")
        heights = numbers(PATCH_CELLS**2, f"heights of {what}")
        tasks = np.array([numbers(4, f"x y yaw cost of goal {k} of {what}") for k in range(N_ABSTRACT_ACTIONS)])
        if np.isnan(tasks).any() or (tasks[:, 3] < 0).any():
            raise InputError(f"published labels {path}: {what} (number {index}) has a cost below 0 or no cost")
        if wrong := np.flatnonzero(np.abs(abstract_steps(tasks[:, :3]) - ABSTRACT_ACTIONS).max(axis=1) > 1e-4).tolist():
            raise InputError(f"published labels {path}: goal {wrong[0]} of {what} is not the action of that place")
        yield index, heights, tasks
    if (rest := next(rows, None)) is not None:
        raise InputError(f"published labels {path}, line {rest[0]}: more lines than the stated number of maps needs")


def _numbers(values) -> str:
    return " ".join(f"{value:.{_DIGITS}f}" for value in values)


if __name__ == "__main__":
    main()
