"""Start and goal of a query: states at which a plan may begin and end.

- `location`: the detailed state at a pose
- `departure`: the ground under a robot that stands at the start; `way_out`: the way out of the clearance of obstacles
- `arrival`: states within a tolerance, of a free heading, of several goals
- `nearby`: poses that the robot can leave, and the nearest of them
"""
