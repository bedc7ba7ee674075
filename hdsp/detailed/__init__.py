"""The detailed planner: 7D states, five kinds of action, weighted A* with reopening (paper, Sec. V-A)."""
