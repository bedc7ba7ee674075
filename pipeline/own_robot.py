"""All stages for another robot, in its own folder.

    python -m pipeline.own_robot robot=anymal_wheels profile=own_robot

`robot` names a file in hdsp/robot/presets (conf/robot points there). Labels, training, evaluation and planning go to
outputs/robots/NAME. Earlier results stay there: a second call continues. The figures and a picture also go into
docs/own-robot.md if this page has the robot's markers.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.robot.robot import Robot

from .config_types import Config
from .evaluate import evaluate
from .label import label
from .plan import plan
from .publish_pages import put_between_markers
from .scan_courses import scan_courses
from .stage import Folders, read_json, run_stage
from .tables import markdown, percent
from .train import train

PAGE = Path("docs/own-robot.md")


def own_robot(config: Config, folders: Folders) -> None:
    robot = config.robot
    check_name(robot)
    config.model.checked_options()  # before labels are made
    folders = Folders(folders.outputs, folders.outputs)  # each stage reads the outputs of earlier stages
    for split in (*config.trainer.splits, *config.trainer.val_splits, "random"):
        (scan_courses if split in config.simulation.splits else label)(config, folders, split)
    train(config, folders)
    evaluate(config, folders)
    plan(config, folders)
    text = section(robot, config.profile, read_reports(folders))
    with replacing(folders.write("reports", "own_robot.md")) as path:
        path.write_text(text, encoding="utf-8")
    print(text)
    write_page(PAGE, robot.name, text, folders.read("reports", "figures", "planned_path.png"))


def check_name(robot: Robot) -> None:
    """Checks that a robot's file and its name agree: outputs and abstractions use the name, `robot=NAME` the file.

    Raises:
        InputError: a file with another name holds a robot with this name.
    """
    if others := [file for file in Robot.presets() if file != robot.name and Robot.load(file).name == robot.name]:
        raise InputError(
            f"hdsp/robot/presets/{others[0]}.yaml: its name is {robot.name!r}; need the file's, {others[0]!r}"
        )


def markers(robot: str) -> tuple[str, str]:
    """Markers around a robot's figures on the page."""
    return f"<!-- {robot}: written by `python -m pipeline.own_robot` -->", f"<!-- end of {robot} -->"


def write_page(page: Path, robot: str, text: str, picture: Path) -> None:
    """Writes figures and a path picture to the page, if it has a place for this robot."""
    if page.is_file() and markers(robot)[0] in page.read_text(encoding="utf-8"):
        shown = page.parent / "figures" / f"{robot}.png"
        shutil.copyfile(picture, shown)
        put_between_markers(page, f"{text}\n![A path of {robot}](figures/{shown.name})\n", *markers(robot))


def place(config: Config) -> str:
    """Returns this robot's folder, in which a second call finds earlier results."""
    return f"outputs/robots/{config.robot.name}"


def read_reports(folders: Folders) -> dict[str, Any]:
    names = ("training", "abstraction_quality", "planning")
    return {name: read_json(folders.read("reports", f"{name}.json")) for name in names}


def section(robot: Robot, profile: str, reports: dict[str, Any]) -> str:
    """Results as Markdown."""
    training, sets = reports["training"], reports["abstraction_quality"]["sets"]
    random = sets["random"]
    if not random["available"]:
        raise InputError(f"own robot: no random set: {random['reason']}")
    quality = [
        (method, percent(values["feasibility_accuracy"]), _digits(values["cost_error"]))
        for method, values in random["methods"].items()
    ]
    runs = [
        (
            run["pair"], run["heuristic"], f"{run['weight']:g}", run["status"], _digits(run["cost"]),
            f"{run['expansions']:,}", f"{run['seconds']:.2f}", str(run["steps"]),
        )
        for run in reports["planning"]["runs"]
    ]  # fmt: skip
    return (
        f"Robot `{robot.name}`, profile `{profile}`. Training: {training['maps']:,} maps, {training['epochs']} epochs, "
        f"network `{training['model']}` ({training['parameters']:,} parameters), {training['seconds']:.0f} s. Test: "
        f"{random['maps']} random maps ({random['tasks']:,} tasks, {100 * random['feasible'] / random['tasks']:.0f} % "
        "feasible).\n\n"
        + markdown(("abstraction", "feasibility correct", "cost error"), quality)
        + "\n\n"
        + markdown(("task", "heuristic", "W", "ended", "cost", "expansions", "seconds", "steps"), runs)
        + "\n"
    )


def _digits(value: float | None) -> str:
    return "–" if value is None else f"{value:.4f}"


if __name__ == "__main__":
    run_stage(own_robot, "own_robot", place=place)
