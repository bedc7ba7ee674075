"""Comparison of trainings: tables in docs/architectures.md and docs/figures/pareto.png.

    python -m pipeline.compare

Sweeps leave runs in `outputs/zoo/NAME` and `outputs/ablations/NAME`. They become `reports/zoo.json`, together with
measured times for every model in conf/model, and `reports/ablations.json`. Earlier report entries stay if they belong
to the same model or experiment. The page comes from the reports alone and needs no training. dvc.yaml has no stage for
this comparison, because none makes these runs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hdsp.base.errors import InputError
from hdsp.robot.lattice import ABSTRACT_HEADINGS, abstract_shape

from .config import CONF, compose, flatten, plain
from .config_types import Config
from .publish_pages import put_between_markers
from .stage import Folders, read_json, run_stage, write_json
from .tables import EMPTY, markdown, percent

PAGE = "architectures.md"
#: Configuration sections in which experiments may differ.
SECTIONS = ("robot", "terrain", "labelling", "model", "trainer")
ARCHITECTURE = "model.architecture"
#: Reference ablation for all others.
BASE = "base"
#: The two figures per set in `reports/training.json`.
QUALITY = ("feasibility_accuracy", "cost_error")
#: Candidate sets for the Pareto picture: the first one with figures from all models is used.
PICTURED = ("random", "val")
#: Number of states in a time measurement patch by patch, and their heading; dense evaluation is measured with all
#: states at this heading.
SAMPLED, HEADING = 500, 2
SIDE = 400  # cells along a 10 m map


def compare(config: Config, folders: Folders) -> None:
    shown = {}
    for kind, report in REPORTS.items():
        path = folders.write("reports", f"{kind}.json")
        shown[kind] = read_json(path) if path.is_file() else {}
        if runs := runs_of(folders, kind):
            shown[kind] = report(runs, shown[kind])
            write_json(path, shown[kind])
    if trained(shown["zoo"]):
        picture(trained(shown["zoo"]), folders.write("docs", "figures", "pareto.png"))
    page = folders.outputs / "docs" / PAGE
    if page.is_file():
        for kind, table in TABLES.items():
            put_between_markers(page, table(shown[kind]) + "\n", *markers(kind))


def markers(name: str) -> tuple[str, str]:
    """Markers around a table on the page."""
    return f"<!-- {name}: written by `python -m pipeline.compare` -->", f"<!-- end of {name} -->"


def runs_of(folders: Folders, kind: str) -> dict[str, Path]:
    """Folders with finished runs, by name."""
    places = sorted(folders.read("outputs", kind).glob("*/reports/training.json"))
    return {place.parents[1].name: place.parents[1] for place in places}


def zoo_report(runs: Mapping[str, Path], before: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each model: figures measured here, and its training result.

    The result comes from the model's run, or from the report before if the number of parameters is the same.

    Raises:
        InputError: numbers of maps or epochs differ between results.
    """
    report: dict[str, dict[str, Any]] = {name: measured(settings) for name, settings in models(runs).items()}
    for name, values in report.items():
        if name in runs:
            values |= outcome(read_json(runs[name] / "reports" / "training.json"))
        elif before.get(name, {}).get("parameters") == values["parameters"]:
            values |= outcome(before[name])
    budgets = {name: f"{values['maps']} maps {values['epochs']} epochs" for name, values in trained(report).items()}
    _require_equal("zoo", budgets, runs)
    return report


def _require_equal(kind: str, budgets: Mapping[str, str], runs: Mapping[str, Path]) -> None:
    if len(set(budgets.values())) > 1:
        told = ", ".join(f"{name} {budget}" for name, budget in budgets.items())
        older = [name for name in budgets if name not in runs]
        hint = f"; remove reports/{kind}.json to leave out those without a run: {', '.join(older)}" if older else ""
        raise InputError(f"runs of the {kind} have different budgets and cannot be compared: {told}{hint}")


def models(runs: Mapping[str, Path]) -> dict[str, Any]:
    """Settings of every model in conf/model, and of the models in runs, as trained."""
    found = {path.stem: plain(compose([f"model={path.stem}"]).model) for path in sorted(CONF.glob("model/*.yaml"))}
    return found | {
        name: read_json(run / "models" / "abstraction" / "config.json")["model"] for name, run in runs.items()
    }


def measured(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Size and speed of a model, measured with random weights, which have no influence on them."""
    from hdsp.base.settings import load_settings
    from hdsp.learning import HardwareSettings, LearnedAbstraction, ModelSettings, build_network, count_parameters

    hardware = HardwareSettings("cpu", threads=1)
    hardware.apply_threads()
    model = load_settings(ModelSettings, settings, "model")
    network = build_network(model)
    seconds = map_seconds(LearnedAbstraction(network, model, hardware=hardware))
    return {"parameters": count_parameters(network), "dense": network.is_dense(), "map_seconds": seconds}


def ablation_report(runs: Mapping[str, Path], before: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each ablation: its training result, and its differences from the base.

    The result comes from the ablation's run, or from the report before if the experiment still exists with the same
    differences.

    Raises:
        InputError: numbers of epochs differ. Numbers of maps may differ, and the table shows them.
    """
    base = experiment_settings(BASE)
    report: dict[str, dict[str, Any]] = {}
    for name in sorted({*before, *runs}):
        different = differences(base, experiment_settings(name))
        if name in runs:
            report[name] = outcome(read_json(runs[name] / "reports" / "training.json")) | {"different": different}
        elif different is not None and before[name]["different"] == different:
            report[name] = dict(before[name])
    _require_equal("ablations", {name: f"{values['epochs']} epochs" for name, values in report.items()}, runs)
    return report


def trained(zoo: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Models in the zoo with a training result."""
    return {name: run for name, run in zoo.items() if QUALITY[0] in run}


def outcome(training: Mapping[str, Any]) -> dict[str, Any]:
    """Selected values from `reports/training.json`; empty if it has none."""
    return {key: training[key] for key in ("maps", "epochs", "best_epoch", *QUALITY) if key in training}


def experiment_settings(name: str) -> dict[str, Any] | None:
    """Flat configuration for the experiment with this file name; None if there is no such experiment."""
    for path in sorted(CONF.glob(f"experiment/**/{name}.yaml")):
        config = compose([f"experiment={path.relative_to(CONF / 'experiment').with_suffix('').as_posix()}"])
        return flatten({section: config[section] for section in SECTIONS})
    return None


def differences(base: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Settings that differ from the base; value None for settings of the base alone. None if a side is unknown.

    A different architecture stands for all model settings; a missing section stands for all its settings.
    """
    if base is None or other is None:
        return None
    missing = object()
    keys = {**base, **other}
    found = {key: other.get(key) for key in keys if base.get(key, missing) != other.get(key, missing)}
    if ARCHITECTURE in found:
        return {key: value for key, value in found.items() if key == ARCHITECTURE or not key.startswith("model.")}
    gone = tuple(f"{key}." for key, value in found.items() if value is None)
    return {key: value for key, value in found.items() if not key.startswith(gone)}


def map_seconds(abstraction) -> float:
    """CPU seconds on one core for all action costs on a 10 x 10 m map, extrapolated from a part.

    The map is noise without equal patches, so no patch is evaluated only once for several states.
    """
    from hdsp.learning import LearnedCosts
    from hdsp.terrain.height_map import HeightMap

    random = np.random.default_rng(0)
    terrain = HeightMap(random.uniform(0, 0.2, (SIDE, SIDE)).astype(np.float32))
    costs = LearnedCosts(abstraction)
    mask = np.zeros((ABSTRACT_HEADINGS, *abstract_shape(terrain.shape)), bool)
    states = mask[HEADING].size
    if abstraction.network.is_dense():
        mask[HEADING] = True
    else:
        mask[HEADING].flat[random.choice(states, SAMPLED, replace=False)] = True
    few = mask & (np.cumsum(mask).reshape(mask.shape) <= 5)
    costs.edges(terrain, mask=few)  # libraries choose their algorithms
    started = time.process_time()
    costs.edges(terrain, mask=mask)
    return (time.process_time() - started) * mask.size / mask.sum()


def zoo_table(zoo: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown table: one model per row, the fastest first; bold names lie on a Pareto front in the picture."""
    runs = trained(zoo)
    if not runs:
        return "No runs yet."
    sets, best = sets_of(runs), fronts(runs)
    rows = []
    for name, run in sorted(zoo.items(), key=lambda item: item[1]["map_seconds"]):
        rows.append([
            f"**{name}**" if name in best else name,
            f"{run['parameters']:,}",
            f"{run['map_seconds']:.1f}",
            "dense" if run["dense"] else "patches",
            *(quality(run, of) if name in runs else EMPTY for of in sets),
        ])  # fmt: skip
    run, states = next(iter(runs.values())), ABSTRACT_HEADINGS * math.prod(abstract_shape((SIDE, SIDE)))
    note = (
        f"Each model is trained on {run['maps']:,} maps for {run['epochs']} epochs. The last columns give feasibility "
        "correct / mean cost error. Bold models lie on a Pareto front in the picture. The time covers all actions from "
        f"all {states:,} states on a map without equal patches, in CPU seconds on one core. It is extrapolated from "
        f"{SAMPLED:,} patches or, for dense networks, from all states at one heading.\n\n"
        "![Errors over time](figures/pareto.png)"
    )
    return markdown(["model", "parameters", "10 x 10 m map, s", "evaluated", *sets], rows) + "\n\n" + note


def ablation_table(ablations: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown table: one experiment per row, with its difference to the base in brackets."""
    if not ablations:
        return "No runs yet."
    if BASE not in ablations:
        raise InputError(f"ablations: there is no run {BASE!r} to compare with; there are {', '.join(ablations)}")
    base = ablations[BASE]
    sets = sets_of(ablations)
    rows = [[BASE, EMPTY, f"{base['maps']:,}", *(quality(base, of) for of in sets)]]
    for name, run in ablations.items():
        if name != BASE:
            told = ", ".join(f"{key}: {_plain(value)}" for key, value in (run["different"] or {}).items())
            figures = (f"{quality(run, of)} ({change(run, base, of)})" for of in sets)
            rows.append([name, told or EMPTY, f"{run['maps']:,}", *figures])
    note = (
        f"Each experiment is trained for {base['epochs']} epochs. The last columns give feasibility correct / mean "
        "cost error, and in brackets the difference to the base."
    )
    return markdown(["experiment", "difference", "maps", *sets], rows) + "\n\n" + note


def sets_of(runs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Names of all sets with figures, except the set that selected the epochs."""
    return list(dict.fromkeys(of for run in runs.values() for of in run["feasibility_accuracy"] if of != "val"))


def quality(run: Mapping[str, Any], of: str) -> str:
    """Feasibility accuracy and cost error on a set."""
    accuracy, error = (run[key].get(of) for key in QUALITY)
    return EMPTY if accuracy is None or error is None else f"{percent(accuracy)} / {error:.4f}"


def change(run: Mapping[str, Any], base: Mapping[str, Any], of: str) -> str:
    """Differences of both figures to the base: accuracy in percent points, cost error as a plain number."""
    if EMPTY in (quality(run, of), quality(base, of)):
        return EMPTY
    accuracy, error = (run[key][of] - base[key][of] for key in QUALITY)
    return f"{100 * accuracy:+.2f} / {error:+.4f}"


def panels(zoo: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Both errors in the picture, for each model, on the first set with figures from all models."""
    common = [of for of in PICTURED if all(quality(run, of) != EMPTY for run in zoo.values())]
    if not common:
        raise InputError(f"runs of the zoo: no set of {', '.join(PICTURED)} has figures of all models")
    of = common[0]
    return {
        f"tasks judged wrongly (%), {of}": {k: 100 * (1 - run["feasibility_accuracy"][of]) for k, run in zoo.items()},
        f"mean cost error, {of}": {k: run["cost_error"][of] for k, run in zoo.items()},
    }


def fronts(zoo: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Names of models on a Pareto front of error over time."""
    from hdsp.viz import pareto_front

    names = list(zoo)
    found: set[str] = set()
    for errors in panels(zoo).values():
        found |= {names[i] for i in pareto_front([(zoo[name]["map_seconds"], errors[name]) for name in names])}
    return found


def picture(zoo: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    from hdsp.viz import save_pareto

    save_pareto({name: run["map_seconds"] for name, run in zoo.items()}, panels(zoo), path)


#: Report and page table for each kind of run.
REPORTS = {"zoo": zoo_report, "ablations": ablation_report}
TABLES = {"zoo": zoo_table, "ablations": ablation_table}


def _plain(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True).removesuffix("\n").removesuffix("\n...")


if __name__ == "__main__":
    run_stage(compare, "compare")
