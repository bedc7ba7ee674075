"""Labels: tasks labelled by the detailed planner, their files, and the evaluation of abstractions."""
