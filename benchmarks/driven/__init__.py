"""Plans driven in physics: `python -m benchmarks.driven`.

- `__main__`: the command
- `tasks`: ground, start and goal of each task
- `ways`: tasks with two ways between the same poses
- `runs`: planning, driving, and results in files
- `slope_limits`: the steepest ground on which a robot drives
- `summary`: shares, rank correlation, page and pictures
"""
