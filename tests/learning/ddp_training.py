"""A small training with several processes: python -m tests.learning.ddp_training DEVICES FOLDER."""

import os
import sys
from pathlib import Path

from hdsp.learning import train
from hdsp.learning.training_parts import TaskMean, TrainingParts
from tests.learning.synthetic import synthetic_tasks, tiny_config


def main(devices: int, folder: str) -> None:
    """Trains in a folder; the first process leaves history.json there."""
    config = tiny_config(epochs=2, mirror=True)
    config["model"] = {"architecture": "table", "options": {"widths": [4, 4, 4, 4], "hidden": 16}}
    config["lightning"] = {"devices": devices, "strategy": "ddp" if devices > 1 else "auto"}
    parts = TrainingParts(metrics={"mean_cost": lambda: TaskMean(lambda cost, *_: cost)})
    train(config, synthetic_tasks(40), {"val": synthetic_tasks(21, seed=1)}, folder, quiet=True, parts=parts)
    if os.environ.get("LOCAL_RANK", "0") == "0":
        Path(folder, "done").touch()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
