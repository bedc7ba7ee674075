"""The detailed actions.

- `action`: `Action` and its one-byte code in the search
- `successors`: all successors of a state; driving and turning
- `manoeuvres`: foot moves, base shifts and steps
- `state_costs`: cost and validity of a state
"""

from hdsp.detailed.actions.action import Action, ActionKind, action_of
from hdsp.detailed.actions.successors import Rules

__all__ = ["Action", "ActionKind", "Rules", "action_of"]
