"""Figures as PNG files. Importing this package loads matplotlib; no other package in `hdsp` does."""

from hdsp.viz.arena_figure import save_arena, save_courses, save_note
from hdsp.viz.charts import (
    save_planning_bars,
    save_quality_bars,
    save_reliability,
    save_training_beside,
    save_training_curves,
)
from hdsp.viz.motion_figure import save_motion
from hdsp.viz.pareto import pareto_front, save_pareto
from hdsp.viz.patch_figure import save_example_patches
from hdsp.viz.path_figure import draw_path, planned_path_figure, save_planned_path, save_planned_paths
from hdsp.viz.robot_drawing import draw_pose, draw_robot
from hdsp.viz.scan_figure import ScanPicture, save_map, save_scan_sheet
from hdsp.viz.style import draw_terrain

__all__ = [
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
