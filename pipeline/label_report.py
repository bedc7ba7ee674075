"""A profile's labels beside the paper's, from its shards: `reports/labels.json` and the table `labels.md`.

    python -m pipeline.label_report profile=paper runtime.inputs=outputs/paper runtime.outputs=.

dvc.yaml has no stage for this report, because it describes one fully labelled profile, independent of the pipeline's
profile.
"""

from __future__ import annotations

import json
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

from .config_types import Config
from .label_places import label_run, not_there, shards_place
from .paper import LABELS
from .stage import Folders, run_stage, write_json


def label_report(config: Config, folders: Folders) -> None:
    from hdsp.labels.run.label_summary import describe_labels
    from hdsp.labels.shards import shard_paths

    splits: dict[str, Any] = {}
    for split, chosen in config.labelling.splits.items():
        if chosen.sensing or not chosen.standable:
            continue  # the paper has no splits of this kind
        place = shards_place(config, folders.inputs, split)
        if not shard_paths(place):
            raise InputError(not_there(place))
        ours = describe_labels(label_run(config, split), place)
        records = folders.read("data", "label_runs", f"{split}.jsonl")
        lines = records.read_text(encoding="utf-8").splitlines() if records.is_file() else []
        splits[split] = {**ours, "paper": LABELS.get(split), "runs": [json.loads(line) for line in lines]}
    write_json(folders.write("reports", "labels.json"), {"profile": config.profile, "splits": splits})
    markdown = table(splits)
    with replacing(folders.write("reports", "labels.md")) as path:
        path.write_text(markdown + "\n", encoding="utf-8")
    print(markdown)


def table(splits: dict[str, Any]) -> str:
    """Markdown table: one row for each split and category, with the paper's counts beside ours."""
    header = ["split", "category", "maps kept", "of", "paper", "tasks", "paper", "feasible", "cost", "paper"]
    rows = []
    for split, values in splits.items():
        paper = values["paper"] or {}
        rows.append(_row(split, "all", values, paper))
        rows += [_row("", name, of_it, {}) for name, of_it in values["categories"].items()]
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _row(split: str, category: str, values: dict[str, Any], paper: dict[str, Any]) -> list[str]:
    return [
        split,
        category,
        f"{values['maps']:,}",
        f"{values['maps_before']:,}",
        f"{paper['maps']:,}" if "maps" in paper else "",
        f"{values['tasks']:,}",
        f"{paper['tasks']:,}" if "tasks" in paper else "",
        f"{100 * values['feasible_share']:.1f} %" if values["maps"] else "",
        _cost(values["cost_mean"], values["cost_std"]),
        _cost(paper.get("cost_mean"), paper.get("cost_std")),
    ]


def _cost(mean: float | None, std: float | None) -> str:
    return f"{mean:.3f} ± {std:.3f}" if mean is not None and std is not None else ""


if __name__ == "__main__":
    run_stage(label_report, "label_report")
