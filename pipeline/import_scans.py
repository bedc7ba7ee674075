"""Stage `import_scans`: scans of real places -> height maps, patches where the robot can stand, and their labels."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import made_folder

from .config_types import Config
from .stage import Folders, run_stage, write_json
from .task_sets import ABSENT, remove_results


def import_scans(config: Config, folders: Folders) -> None:
    from hdsp.labels.scan_patches import draw_starts, label_scan
    from hdsp.terrain.scans import build_map, find_files
    from hdsp.viz import ScanPicture, save_scan_sheet

    robot = config.robot
    rules, patches, scans = config.labelling.settings, config.scans.patches, list(config.scans.sources.values())

    folder = made_folder(folders.write("data", "real"))
    ours = _own_shards(folder)
    remove_results(folder, *ours - {f"{scan.name}.h5" for scan in scans})
    maps = made_folder(folders.write("data", "real_maps"))
    report: dict[str, Any] = {"scans": {}, "missing": {}}
    pictures = []
    for scan in scans:
        paths, reason = find_files(scan, config.runtime.data_dir)
        if not paths:
            print(f"skipped: {reason}")
            report["missing"][scan.name] = reason
            remove_results(folder, *ours & {f"{scan.name}.h5"})
            continue
        terrain = build_map(scan, paths)
        terrain.save(maps / f"{scan.name}.npz")
        about = {name: getattr(scan, name) for name in ("place", "sensor", "licence", "source")} | {"scan": scan.name}
        shard = folder / f"{scan.name}.h5"
        tasks = label_scan(terrain, robot, patches, rules, shard, about)
        report["scans"][scan.name] = about | _figures(terrain, tasks)
        pictures.append(
            ScanPicture(scan.name, scan.place, scan.licence, terrain, draw_starts(terrain, robot, patches), tasks)
        )
        print(f"{scan.place} ({scan.name}): {len(tasks)} patches, {tasks.feasible.sum()} feasible tasks")
    if not pictures and not any(folder.glob("*.h5")):
        write_json(folder / ABSENT, {"reason": "; ".join(report["missing"].values())})
    places = {scan["place"]: 0 for scan in report["scans"].values()}
    for scan in report["scans"].values():
        places[scan["place"]] += scan["patches"]
    report |= {"patches": sum(places.values()), "patches_per_place": places}
    write_json(folders.write("reports", "real_scans.json"), report)
    save_scan_sheet(pictures, folders.write("reports", "figures", "real_scans.png"), robot)
    print(f"{report['patches']} patches from {len(places)} places")


def _own_shards(folder: Path) -> set[str]:
    """Names of the shards in a folder that this stage wrote; a user may have added others."""
    from hdsp.labels.shards import read_attributes

    names = set()
    for path in folder.glob("*.h5"):
        with suppress(InputError):  # no shard, or a damaged one, which a scan of this name replaces
            if read_attributes(path).get("scan") == path.stem:
                names.add(path.name)
    return names


def _figures(terrain, tasks) -> dict[str, Any]:
    known = np.isfinite(terrain.heights)
    heights = terrain.heights[known]
    return {
        "size": [float(side) for side in terrain.size],
        "known_area": float(known.sum() * terrain.resolution**2),
        "on_floor": float((np.abs(heights) < 0.03).mean()),
        "highest": float(heights.max()),
        "patches": len(tasks),
        "tasks": int(tasks.feasible.size),
        "feasible": int(tasks.feasible.sum()),
    }


if __name__ == "__main__":
    run_stage(import_scans, "import_scans")
