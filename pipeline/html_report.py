"""The report of a pipeline run as one HTML file: tables, pictures, paths in three dimensions, data and their hashes.

The file needs no network and no other file. The page comes from `report_page.html`; pictures and scenes are in it.
"""

from __future__ import annotations

import base64
import io
import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hdsp.base.errors import InputError, RefinementError
from hdsp.base.files import replacing

from .config_types import Config
from .headline import headline_table
from .seconds import PLACE
from .seconds import table as seconds_table
from .stage import Folders, read_json
from .stored_paths import PathKey, StoredPath, read_paths
from .tables import HEURISTIC_NAMES, abstraction_quality_table, heuristic_table, markdown, random_task_table

#: Width of pictures in pixels; wider ones are scaled down.
WIDTH = 1600
#: Heuristics whose paths are shown, the first one with paths; and the weight next to which they are.
SHOWN, WEIGHT = ("shipped", "trained", "manual"), 1.25
#: Packages whose versions are named.
PACKAGES = ("hdsp", "numpy", "numba", "scipy", "torch", "onnxruntime", "mujoco")
#: Pictures by name, with their captions.
PICTURES = {
    "abstraction_quality": "Quality of the abstractions on each set.",
    "reliability": "Calibration: how often tasks with a predicted probability are feasible.",
    "example_patches": "Patches and tasks, as labelled and as judged.",
    "planning": "Times and costs of the searches, by heuristic and weight.",
    "planned_path": "One path in detail.",
    "planned_paths": "The paths of all tasks.",
    "training_curves": "Training: quality on the validation maps after each epoch.",
    "arena": "The arena and its scan by a simulated lidar.",
    "simulated_courses": "Courses for the set of simulated scans.",
    "real_scans": "Maps from scans of real places, with the patches cut out of them.",
}


def write_html_report(config: Config, folders: Folders, reports: Mapping[str, Any]) -> Path:
    """Writes `reports/index.html`.

    Args:
        config: the configuration of the run.
        folders: where the stages' results are.
        reports: contents of `abstraction_quality.json`, `planning.json` and `training.json`, by name.
    """
    from jinja2 import Environment, StrictUndefined

    quality, planning, training = (reports[name] for name in ("abstraction_quality", "planning", "training"))
    scenes, series = scenes_of(config, folders, planning)
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    page = template.from_string(Path(__file__).with_name("report_page.html").read_text(encoding="utf-8")).render(
        profile=config.profile,
        robot=config.robot.name,
        headline=as_html(headline_table(quality, planning)),
        quality=as_html(abstraction_quality_table(quality, training)),
        planning=as_html(heuristic_table(planning)),
        random=as_html(random_task_table(planning["random"])) if "random" in planning else "",
        pictures={name: (data_address(path), PICTURES[name]) for name, path in _pictures(folders).items()},
        scenes=scenes,
        scenes_json=_in_script(scenes),
        series=series,
        training=as_html(_training(training)),
        sources=as_html(_sources(folders)),
        stages=as_html(stage_table(folders)),
        seconds=as_html(_seconds(folders)),
        versions=", ".join(f"{name} {version(name)}" for name in PACKAGES if _installed(name)),
        python=f"Python {platform.python_version()}",
        parameters=_parameters(folders),
    )
    target = folders.write("reports", "index.html")
    with replacing(target) as path:
        path.write_text(page, encoding="utf-8")
    return target


def as_html(text: str) -> Any:
    """Markdown tables and paragraphs as HTML that a template inserts unchanged."""
    from markdown_it import MarkdownIt
    from markupsafe import Markup

    rendered = MarkdownIt("commonmark").enable("table").render(text)
    return Markup(rendered.replace("<table>", '<div class="table"><table>').replace("</table>", "</table></div>"))


def data_address(picture: Path) -> str:
    """A picture as an address that contains it; a wide one is scaled down."""
    from PIL import Image

    image = Image.open(picture)
    scale = min(1.0, WIDTH / image.width)
    smaller = image.convert("RGB").resize((round(scale * image.width), round(scale * image.height)))
    written = io.BytesIO()
    smaller.save(written, "WEBP", quality=82)
    return "data:image/webp;base64," + base64.b64encode(written.getvalue()).decode()


def scenes_of(config: Config, folders: Folders, planning: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Pages of the viewer for the tasks of the arena, and the shown heuristic in words.

    All pages share nearly all of their text, the program of the viewer: it is stored once.

    Returns:
        `before`, `after`: the shared text; `tasks`: name, caption and own text of each page. Without viser or without
        paths, `tasks` is empty. And the heuristic and weight in words, or the reason for the absence of scenes.
    """
    from .plan import read_ground, read_tasks

    nothing: dict[str, Any] = {"before": "", "after": "", "tasks": []}
    try:
        paths = read_paths(folders.read("data", "paths.npz"))
        chosen = chosen_series(paths)
        from hdsp.viz.viewer import plan_page

        ground = read_ground(config.arena, folders)
        terrain = ground.terrain
        # The mesh of a scan, with its noise, takes several MB for each task.
        drawn = terrain if ground.truth is None else ground.truth.height_map()
        tasks = {name: ends for name, ends in read_tasks(terrain, config).items() if PathKey(name, *chosen) in paths}
        pages = {}
        for name, ends in tasks.items():
            states, actions = paths[PathKey(name, *chosen)]
            motion = _motion(terrain, config, states, actions)
            pages[name] = plan_page(drawn, config.robot, states, actions, motion, [np.array(pose) for pose in ends])
    except InputError as error:
        return nothing, str(error)
    heuristic, weight = chosen
    runs = {run["pair"]: run for run in planning["runs"] if (run["heuristic"], run["weight"]) == chosen}
    before, after = shared_text(list(pages.values()))
    own = [
        {"name": name, "caption": _caption(runs.get(name)), "text": page[len(before) : len(page) - len(after)]}
        for name, page in pages.items()
    ]
    words = f"{HEURISTIC_NAMES.get(heuristic, heuristic)}, W = {weight:g}"
    return {"before": before, "after": after, "tasks": own}, words


def chosen_series(paths: Mapping[PathKey, StoredPath]) -> tuple[str, float]:
    """Heuristic and weight whose paths are shown.

    Raises:
        InputError: there are no paths.
    """
    keys = [(key.heuristic, key.weight) for key in paths]
    for heuristic in (*SHOWN, *(heuristic for heuristic, _ in keys)):
        if weights := [weight for name, weight in keys if name == heuristic]:
            return heuristic, min(weights, key=lambda weight: abs(weight - WEIGHT))
    raise InputError("no search in the arena found a path")


def _motion(terrain, config: Config, states, actions):
    """The path as a motion; None where a step cannot be carried out, then the robot is shown in each state."""
    from hdsp.detailed.motion.refinement import refine

    try:
        return refine(terrain, config.robot, states, actions)
    except RefinementError:
        return None


def shared_text(pages: Sequence[str]) -> tuple[str, str]:
    """Longest common beginning and end of texts; they do not overlap."""
    if len(pages) < 2:
        return "", ""
    before = _beginning(pages)
    return before, _beginning([page[len(before) :][::-1] for page in pages])[::-1]


def _beginning(texts: Sequence[str]) -> str:
    """Longest common beginning of texts: that of the first and the last one in alphabetical order."""
    first, last = min(texts), max(texts)
    pairs = enumerate(zip(first, last, strict=False))
    return first[: next((place for place, (a, b) in pairs if a != b), len(first))]


def _caption(run: Mapping[str, Any] | None) -> str:
    if run is None:
        return ""
    return f"cost {run['cost']:.2f}, {run['steps']} steps, {run['expansions']:,} expansions, {run['seconds']:.3f} s"


def _pictures(folders: Folders) -> dict[str, Path]:
    paths = {name: folders.read("reports", "figures", f"{name}.png") for name in PICTURES}
    return {name: path for name, path in paths.items() if path.is_file()}


def _training(training: Mapping[str, Any]) -> str:
    sets = training["feasibility_accuracy"]
    rows = [[name, f"{100 * sets[name]:.2f} %", f"{training['cost_error'][name]:.4f}"] for name in sets]
    return (
        f"Network {training['model']}, {training['parameters']:,} parameters, {training['maps']:,} maps, "
        f"{training['epochs']} epochs in {training['seconds']:.0f} s.\n\n"
        + markdown(["set", "feasibility correct", "mean cost error"], rows)
    )


def _sources(folders: Folders) -> str:
    """Scans of real places with their licences, and the numbers of labelled tasks."""
    parts = []
    labels = sorted(folders.read("reports", "labels").glob("*.json"))
    if labels:
        counts = {path.stem: read_json(path) for path in labels}
        rows = [
            [name, f"{values['maps']:,}", f"{values['tasks']:,}", f"{100 * values['feasible_share']:.1f} %"]
            for name, values in counts.items()
        ]
        parts.append(markdown(["split of random maps", "maps", "tasks", "feasible"], rows))
    scans = folders.read("reports", "real_scans.json")
    if scans.is_file():
        rows = [
            [name, scan["place"], scan["sensor"], str(scan["tasks"]), scan["licence"], scan["source"]]
            for name, scan in read_json(scans).get("scans", {}).items()
        ]
        parts.append(markdown(["scan", "place", "sensor", "tasks", "licence", "source"], rows))
    return "\n\n".join(parts)


def stage_table(folders: Folders) -> str:
    """Commands and hashes of all stages that ran, from dvc.lock; empty outside of DVC."""
    lock = folders.read("dvc.lock")
    if not lock.is_file():
        return ""
    rows = []
    for name, stage in yaml.safe_load(lock.read_text(encoding="utf-8"))["stages"].items():
        if name == "report":
            continue  # runs now, its entry is of the run before
        code = [_hash(dep) for dep in stage.get("deps", []) if dep["path"].startswith("data/code/")]
        outs = [out for out in stage.get("outs", []) if not out["path"].endswith((".png", ".csv"))]
        shown = ", ".join(f"`{out['path']}` {_hash(out)}" for out in outs)
        rows.append([f"`{stage['cmd']}`", *(code or ["–"]), shown])
    return markdown(["command", "code", "results"], rows)


def _seconds(folders: Folders) -> str:
    """Durations of the stages before this one; empty outside of DVC."""
    folder = folders.read(*PLACE.parts)
    return seconds_table(folder) if folder.is_dir() else ""


def _hash(entry: Mapping[str, Any]) -> str:
    return entry.get("md5", "")[:12]


def _parameters(folders: Folders) -> str:
    path = folders.read("params.yaml")
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _installed(package: str) -> bool:
    try:
        version(package)
    except ModuleNotFoundError:
        return False
    return True


def _in_script(values: Any) -> Any:
    """Values as JSON that a script element may contain."""
    from markupsafe import Markup

    return Markup(json.dumps(values, ensure_ascii=False).replace("<", "\\u003c"))
