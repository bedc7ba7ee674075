"""Figures as PNG files, and plans in three dimensions.

- `path_figure`, `motion_figure`: plans on their map, motions from the side
- `arena_figure`, `scan_figure`, `patch_figure`: arenas, scanned maps, labelled patches
- `charts`, `pareto`: qualities, times and training curves of networks
- `robot_drawing`, `style`: the robot and the terrain on axes; colours and names of all figures
- `palette`, `failure_marks`: colours, and the absence of a plan, for figures and the browser
- `viewer`: plans in three dimensions in a browser

Matplotlib is loaded by the first use of a name; no other package in `hdsp` loads it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.viz.arena_figure import save_arena, save_courses, save_note
    from hdsp.viz.charts import (
        save_planning_bars,
        save_quality_bars,
        save_reliability,
        save_training_beside,
        save_training_curves,
    )
    from hdsp.viz.failure_marks import Failure, Mark
    from hdsp.viz.motion_figure import save_motion
    from hdsp.viz.pareto import pareto_front, save_pareto
    from hdsp.viz.patch_figure import save_example_patches
    from hdsp.viz.path_figure import (
        DrawnPath,
        draw_path,
        planned_path_figure,
        save_planned_path,
        save_planned_paths,
    )
    from hdsp.viz.robot_drawing import draw_pose, draw_robot
    from hdsp.viz.scan_figure import ScanPicture, save_map, save_scan_sheet
    from hdsp.viz.style import draw_terrain

__all__ = [
    "DrawnPath",
    "Failure",
    "Mark",
    "ScanPicture",
    "draw_path",
    "draw_pose",
    "draw_robot",
    "draw_terrain",
    "pareto_front",
    "planned_path_figure",
    "save_arena",
    "save_courses",
    "save_example_patches",
    "save_map",
    "save_motion",
    "save_note",
    "save_pareto",
    "save_planned_path",
    "save_planned_paths",
    "save_planning_bars",
    "save_quality_bars",
    "save_reliability",
    "save_scan_sheet",
    "save_training_beside",
    "save_training_curves",
]

#: Module of each public name.
_MODULES = {
    "DrawnPath": "path_figure",
    "Failure": "failure_marks",
    "Mark": "failure_marks",
    "ScanPicture": "scan_figure",
    "draw_path": "path_figure",
    "draw_pose": "robot_drawing",
    "draw_robot": "robot_drawing",
    "draw_terrain": "style",
    "pareto_front": "pareto",
    "planned_path_figure": "path_figure",
    "save_arena": "arena_figure",
    "save_courses": "arena_figure",
    "save_example_patches": "patch_figure",
    "save_map": "scan_figure",
    "save_motion": "motion_figure",
    "save_note": "arena_figure",
    "save_pareto": "pareto",
    "save_planned_path": "path_figure",
    "save_planned_paths": "path_figure",
    "save_planning_bars": "charts",
    "save_quality_bars": "charts",
    "save_reliability": "charts",
    "save_scan_sheet": "scan_figure",
    "save_training_beside": "charts",
    "save_training_curves": "charts",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "matplotlib":
            raise
        errors = import_module("hdsp.base.errors")
        raise errors.InputError("pictures need matplotlib: pip install 'hdsp[viz]'") from error
