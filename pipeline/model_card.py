"""Model card for a shipped abstraction. Every number on it is measured or configured."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hdsp.base.extensions import distribution_of
from hdsp.learning.architectures import ARCHITECTURES, architecture_place
from hdsp.robot import lattice
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import COST_MODEL_VERSION
from hdsp.terrain.scenes import CATEGORIES

from .config import configure, flatten, plain
from .config_types import Config
from .paper import ABSTRACTION_QUALITY
from .tables import markdown, percent
from .train import data_notes

if TYPE_CHECKING:
    from hdsp.learning import LearnedAbstraction

#: Probability from which an action is feasible, where nothing else is said.
EVEN = 0.5


def model_card(
    abstraction: LearnedAbstraction,
    robot: Robot,
    precision: str,
    figures: Mapping[str, Mapping[str, Any]],
    missing: Mapping[str, str],
    config: Config,
    name: str,
    hours: Mapping[str, float],
) -> str:
    """Returns the card as Markdown.

    Args:
        abstraction: abstraction as it will be loaded.
        robot: its robot.
        precision: weight precision in the file.
        figures: for each set the figures from `pipeline.publish_model.figures_of`, with `paper`: the paper's set for
            comparison.
        missing: for each set without data, the reason.
        config: contents of the training maps, and the recipe if the abstraction itself does not hold it.
        name: name in the package.
        hours: effort from `pipeline.publish_model.hours`.
    """
    parts = [
        _head(robot, name),
        _model(abstraction, precision),
        _data(abstraction, robot, config),
        _recipe(abstraction, config, hours),
        _metrics(figures, missing),
        _calibration(abstraction, figures),
        _limits(abstraction, figures, config),
        _again(abstraction, config, robot),
    ]
    return "\n\n".join(parts) + "\n"


def _head(robot: Robot, name: str) -> str:
    source = "learned" if name == robot.name else f"learned:{name}"
    return f"""# Shipped abstraction {name}

`python -m pipeline.publish_model` writes this card; do not edit it. The network reads a height map around a hybrid
driving-stepping robot. It judges the 22 abstract actions: is the action feasible, and how much does it cost?
(Klamt & Behnke, ICRA 2019)

```python
import hdsp

planner = hdsp.Planner(terrain, robot="{robot.name}", heuristic="{source}")  # or, on its own:
feasible, cost = hdsp.load_abstraction("{name}").predict(patches, goals)
```"""


def _model(abstraction: LearnedAbstraction, precision: str) -> str:
    from hdsp.learning import count_parameters

    cells, encoding = lattice.PATCH_CELLS, abstraction.model.encoding
    rows = [
        ("architecture", f"`{abstraction.model.architecture}`, {count_parameters(abstraction.network):,} parameters"),
        ("options", _inline(abstraction.model.options)),
        ("heights", _inline(plain(abstraction.model.to_dict()["encoding"]))),
        ("weights", f"{precision}, safetensors; no pickle"),
        (
            "input",
            f"patch of {cells} x {cells} cells of {lattice.RESOLUTION:g} m along the robot's heading, NaN = unknown; "
            f"goals (dx, dy, dtheta) in steps of {lattice.ABSTRACT_RESOLUTION:g} m and "
            f"{360 / lattice.ABSTRACT_HEADINGS:g} degrees",
        ),
        ("output", "probability of feasibility, and cost (unitless) where feasible"),
        ("edges", f"an action is feasible from a probability of {abstraction.edges_threshold:g}"),
        ("height limits", f"{encoding.clip[0]:g} and {encoding.clip[1]:g} m; heights beyond are clipped to them"),
    ]
    return "## Model\n\n" + markdown(("property", "value"), rows)


def _data(abstraction: LearnedAbstraction, robot: Robot, config: Config) -> str:
    provenance = abstraction.provenance
    notes = provenance.notes
    rows: list[tuple[str, str]] = [
        ("robot", f"{robot.name}, hash `{provenance.robot_hash[:16]}`"),
        ("cost model", f"version {provenance.cost_model_version} (docs/cost-model.md)"),
        ("labels", f"hash `{provenance.labels_hash[:16]}`" if provenance.labels_hash else "not recorded"),
    ]
    if "maps" in notes:
        rows.append(("training maps", f"{notes['maps']:,} with 22 tasks each"))
    data = _data_notes(abstraction, config)
    rows += [
        (f"{'scanned courses' if name in _scanned(data) else 'random maps'} `{name}`", _inline(split))
        for name, split in data["splits"].items()
    ]
    rows.append(("contents of a map", _inline(data["terrain"])))
    if _sensed(data):
        rows.append(("sensor model", _inline(data["sensing"])))
    return (
        "## Training data\n\nThe training maps are random height maps (`hdsp/terrain/scenes.py`, "
        "`hdsp/terrain/sensor_model.py`) and, where listed, patches of simulated scans "
        "(`hdsp/labels/course_patches.py`). The optimal detailed planner labels them. Maps without a valid start state "
        "are dropped. A split with `standable` False keeps only these maps; all their tasks are infeasible.\n\n"
        + markdown(("property", "value"), rows)
    )


def _data_notes(abstraction: LearnedAbstraction, config: Config) -> dict[str, Any]:
    """Like `pipeline.train.data_notes`; the current configuration if the model holds no notes."""
    notes = abstraction.provenance.notes
    if "splits" in notes:
        return notes
    trainer = notes.get("trainer") or plain(config.trainer)
    return data_notes(config, trainer.get("splits") or ["train"])


def _sensed(data: Mapping[str, Any]) -> list[str]:
    """Splits whose maps pass through the sensor model."""
    return [name for name, split in data["splits"].items() if split.get("sensing")]


def _scanned(data: Mapping[str, Any]) -> list[str]:
    """Splits whose maps are patches from simulated scans."""
    return [name for name, split in data["splits"].items() if "courses" in split]


def effort(hours: Mapping[str, float]) -> str:
    """Returns a sentence for each known effort from `pipeline.publish_model.hours`."""
    said = {
        "labels": "Its labels took {:.1f} core hours.",
        "training": "Training took {:.1f} hours.",
        "last": "The last training took {:.1f} hours.",
    }
    return " ".join(sentence.format(hours[name]) for name, sentence in said.items() if name in hours)


def _recipe(abstraction: LearnedAbstraction, config: Config, hours: Mapping[str, float]) -> str:
    notes = abstraction.provenance.notes
    recorded = notes.get("trainer")
    source = "as recorded with the model" if recorded else "as configured at publication"
    rows = _settings(recorded or plain(config.trainer))
    if "profile" in notes:
        rows.insert(0, ("`profile`", str(notes["profile"])))
    if "epoch" in notes:
        rows.insert(0, ("state", str(notes["epoch"])))
    table = markdown(("setting", "value"), rows)
    begun = "It"
    for initial in _trainings(notes)[1:]:
        first = [
            ("`maps`", f"{initial['maps']:,}"),
            *_settings(initial.get("model", {})),
            *_settings(initial["trainer"]),
        ]
        if "epoch" in initial:
            first.insert(0, ("state", str(initial["epoch"])))
        table += f"\n\n{begun} started from the weights of an earlier training:\n\n"
        table += markdown(("setting", "value"), first)
        begun = "That training"
    text = f"The recipe is the section `trainer` of the configuration, {source}. {effort(hours)}".strip()
    return f"## Training recipe\n\n{text}\n\n{table}"


def _trainings(notes: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Notes of a training, of the one that its weights come from, and so on.

    The notes of an earlier training name the model's options that its successor changed; ``model`` here names all that
    differ from the last training.
    """
    if "initial" not in notes:
        return [notes]
    initial = dict(notes["initial"])
    changed = [each.get("model", {}).get("options", {}) for each in (notes, initial)]
    if options := changed[0] | changed[1]:
        initial["model"] = {"options": options}
    return [notes, *_trainings(initial)]


def _settings(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(f"`{key}`", str(value)) for key, value in flatten(values).items()]


def _metrics(figures: Mapping[str, Mapping[str, Any]], missing: Mapping[str, str]) -> str:
    rows = []
    for name, values in figures.items():
        paper = ABSTRACTION_QUALITY.get(values.get("paper") or "", {}).get("learned", {})
        rows.append((
            name, f"{values['maps']:,}", f"{values['tasks']:,}",
            percent(values["feasibility_accuracy"]), percent(paper.get("feasibility_accuracy")),
            _cost(values["cost_error"]), _cost(paper.get("cost_error")), _cost(values["planning_cost_error"]),
            percent(values["false_feasible"]), percent(values["false_infeasible"]),
        ))  # fmt: skip
    header = (
        "set", "maps", "tasks", "feasibility correct", "the paper's", "cost error", "the paper's",
        "planning cost error", "wrongly feasible", "wrongly infeasible",
    )  # fmt: skip
    text = (
        "## Metrics\n\nThe metrics compare the network with the detailed planner. The set `val` chose the epoch; no "
        "other set took part. The cost error is the mean absolute difference over tasks that both judge feasible; the "
        "planning cost error is the same for costs for planning (docs/cost-model.md). The paper's figures belong to "
        "the paper's own sets; `published` stands beside its simulated set.\n\n" + markdown(header, rows)
    )
    if missing:
        text += "\n\nWithout data: " + "; ".join(f"{name} ({reason})" for name, reason in missing.items()) + "."
    categories = [
        (
            name, category, str(values["maps"]), percent(values["feasibility_accuracy"]), _cost(values["cost_error"]),
        )
        for name, set_figures in figures.items() if name != "val"
        for category, values in set_figures["categories"].items() if len(set_figures["categories"]) > 1
    ]  # fmt: skip
    columns = ("set", "category", "maps", "feasibility correct", "cost error")
    return text + ("\n\n" + markdown(columns, categories) if categories else "")


def _calibration(abstraction: LearnedAbstraction, figures: Mapping[str, Mapping[str, Any]]) -> str:
    calibration = abstraction.calibration
    levels = [f"{level:g}" for level in calibration.cost_quantiles]
    rows = [
        (
            name, _cost(values["ece"]), _cost(values["ece_adaptive"]), _cost(values["brier"]),
            *(percent(values["cost_coverage"].get(level)) for level in levels),
        )
        for name, values in figures.items()
    ]  # fmt: skip
    header = ("set", "ECE", "ECE, adaptive", "Brier score", *(f"cost <= q {level}" for level in levels))
    return (
        f"## Calibration\n\nThe calibration is fitted to {calibration.tasks:,} tasks from `val`. It consists of a "
        f"temperature, {calibration.temperature:.3f}, and quantiles of the relative cost error in "
        f"{len(calibration.excess) + 1} groups of tasks (split conformal). ECE is the expected calibration error of "
        "the feasibility probability in 15 bins. `cost <= q a` is the share of tasks with a cost up to the model's "
        "quantile for level a; on exchangeable tasks this share is a.\n\n" + markdown(header, rows)
    )


def _limits(abstraction: LearnedAbstraction, figures: Mapping[str, Mapping[str, Any]], config: Config) -> str:
    levels = list(next(iter(figures.values()))["cost_errors"])
    rows = [(name, *(_cost(values["cost_errors"].get(level)) for level in levels)) for name, values in figures.items()]
    header = ("set", *("largest cost error" if level == 1 else f"{level:.0%} of cost errors up to" for level in levels))
    lines = []
    for name, values in figures.items():
        worst = min(values["categories"].items(), key=lambda item: item[1]["feasibility_accuracy"])
        if name != "val" and len(values["categories"]) > 1:
            accuracy = percent(worst[1]["feasibility_accuracy"])
            lines.append(f"- Lowest accuracy in set `{name}`: {worst[0]}, {accuracy} on {worst[1]['maps']} maps.")
    data = _data_notes(abstraction, config)
    terrain = data["terrain"]
    highest = max(_largest(value) for key, value in terrain.items() if key.endswith(("height", "rise")))
    scanned, sensed = _scanned(data), _sensed(data)
    random_maps = [split for name, split in data["splits"].items() if name not in scanned]
    kinds = dict.fromkeys(kind for split in random_maps for kind in split.get("categories", CATEGORIES))
    lines += [
        f"- Training used these kinds of random terrain{'' if scanned else ' only'}: {', '.join(kinds)}. The network "
        f"never saw round or soft objects, staircases with more than {_largest(terrain['staircase_steps']):g} steps, "
        f"or objects higher than {highest:g} m.",
        f"- Sensor noise, unknown cells and rounded edges were in the splits {', '.join(sensed)}. They came from a "
        "model, not from a sensor."
        if sensed
        else "- The network never saw sensor effects: noise, unknown cells, rounded edges.",
        f"- Training used simulated scans ({', '.join(scanned)}) like the set `simulated`, with other seeds. Only the "
        "figures for `real` show the accuracy on scans from elsewhere."
        if scanned
        else "- The figures for `simulated` and `real` show the accuracy on scans.",
        f"- The network holds for this robot with these constants and cost model version {COST_MODEL_VERSION}; loading "
        "it for another robot is an error. The labels come from the planner; no real robot has driven them, but a "
        "simulated one drives along plans (docs/driving.md).",
        "- A wrong heuristic leaves plans valid: the detailed planner checks every action of a plan.",
    ]
    return "## Limits\n\n" + markdown(header, rows) + "\n\n" + "\n".join(lines)


def _again(abstraction: LearnedAbstraction, config: Config, robot: Robot) -> str:
    notes = abstraction.provenance.notes
    chosen = [f"profile={notes.get('profile', config.profile)}", f"robot={robot.name}"]
    variant = f" runtime.variant={config.runtime.variant}" if config.runtime.variant else ""
    threshold = abstraction.edges_threshold
    border = f" evaluation.edges_threshold={threshold:g}" if threshold != EVEN else ""
    composed, settings = configure(chosen), chosen
    if composed.model != abstraction.model:
        if abstraction.model.architecture not in ARCHITECTURES:
            return (
                f"## Reproduce\n\nCode and configuration of the network `{abstraction.model.architecture}` belong to "
                f"{distribution_of(architecture_place(abstraction.model.architecture)) or 'a package'} outside of hdsp."
            )
        settings = [*chosen, f"model={abstraction.model.architecture}"]
        composed = configure(settings)
    *later, first = _trainings(notes)
    then, known = "", first
    for training in reversed(later):
        overrides = " ".join([*settings, *_differences(composed, training), "runtime.inputs=. runtime.outputs=."])
        changed = [
            name for name, split in training.get("splits", {}).items() if known.get("splits", {}).get(name) != split
        ]
        for name in changed:
            stage = "scan_courses" if name in composed.simulation.splits else "label"
            then += f"\npython -m pipeline.{stage} {name} {overrides}"
        then += f"""
mv models/abstraction {training["trainer"]["initial"]}
python -m pipeline.train {overrides}"""
        known = training
    overrides = " ".join(f"-S {setting}" for setting in [*settings, *_differences(composed, first)])
    return f"""## Reproduce

These commands use the model and the recipe above.

```sh
dvc exp run {overrides}      # includes the labels: hours{then}
python -m pipeline.publish_model models/abstraction {" ".join(chosen)} runtime.outputs=.{variant}{border}
```"""


def _differences(config: Config, notes: Mapping[str, Any]) -> list[str]:
    """Overrides, quoted for a shell, that turn a configuration into the recorded recipe and numbers of maps."""
    known = flatten(plain(config))
    recorded = {"trainer": notes.get("trainer", {}), "model": notes.get("model", {})}
    for name, split in notes.get("splits", {}).items():
        recorded[f"{'simulation' if name in config.simulation.splits else 'labelling'}.splits.{name}"] = split
    return [
        shlex.quote(f"{key}={_override(value)}")
        for key, value in flatten(recorded).items()
        if (key in known and known[key] != value) or (value is None and _holds(known, key))
    ]


def _holds(known: Mapping[str, Any], section: str) -> bool:
    return any(key.startswith(f"{section}.") for key in known)


def _override(value: Any) -> str:
    if isinstance(value, list):
        return f"[{','.join(map(_override, value))}]"
    return value if isinstance(value, str) else json.dumps(value)


def _largest(value: Any) -> float:
    return float(max(value) if isinstance(value, Sequence) else value)


def _inline(values: Mapping[str, Any]) -> str:
    return ", ".join(f"`{key}` {value}" for key, value in flatten(values).items()) or "none"


def _cost(value: float | None) -> str:
    return "–" if value is None else f"{value:.4f}"
