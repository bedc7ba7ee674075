"""A plan in a notebook: its picture beside its main figures."""

from __future__ import annotations

import math
from typing import Any

from hdsp.planning.answers.explanation import counted
from hdsp.viz.notebook_views import Rows, view_of


def _title(plan: Any) -> str:
    return "Plan" if plan.solved else "No plan"


def _rows(plan: Any) -> Rows:
    """Main figures; limits of the robot are left out, because the search for them may take half a minute."""
    stats = plan.stats
    rows = {"status": str(plan.status).replace("_", " ")}
    if plan.solved:
        proved = f", at most {plan.bound:.3g} × the optimum" if math.isfinite(plan.bound) else ""
        rows |= {
            "cost": f"{plan.cost:.3f}{proved}",
            "actions": f"{len(plan.actions)}, {plan.steps} of them steps",
            "in words": plan.explain(),
        }
    else:
        causes = [*map(str, plan.problems or plan.causes)]
        rows |= {"causes": "; ".join(causes)} if causes else {}
        rows |= {"in reach": str(plan.nearest)} if plan.nearest is not None else {}
        rows |= {"advice": "; ".join(plan.findings.advice)} if plan.findings.advice else {}
    return {
        **rows,
        "robot": plan.robot.name,
        "heuristic": f"{stats.heuristic}, W = {stats.weight:g}",
        "search": counted(stats.expansions, "expansion"),
        "time": f"{stats.seconds:.3g} s",
    }


PLAN_VIEW = view_of(_title, _rows, lambda plan: plan.show())
