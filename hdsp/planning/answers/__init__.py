"""The answer to a query: a plan, or the reason for its absence.

- `plans`, `plan_statistics`, `plan_table`: `Plan`, its statistics, its states as a table
- `explanation`: a plan or its absence in words
- `findings`, `nearest_pose`, `invalid_end`: causes at their places, the nearest pose in reach, an invalid start or goal
- `advice`, `decisive_limits`, `foot_limits`: what would help, and the limits of the robot that decide
"""
