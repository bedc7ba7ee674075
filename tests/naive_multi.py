"""Textbook twin of the multi-heuristic search: shared MHA* as printed, on any graph, slow and simple.

Source: Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016, algorithm SMHA*.
"""

import math

INF = math.inf


def shared_mha(successors, start, goal, anchor, guides, w1, w2):
    """Cost of a path from start to goal, and number of expansions: (cost, [from the anchor, from all guides together]).

    Args:
        successors: function from a state to [(action, reached state, cost)].
        start, goal: states.
        anchor: consistent heuristic, a function of a state.
        guides: other heuristics.
        w1, w2: weights >= 1.
    """
    heuristics = [anchor, *guides]
    g = {goal: INF, start: 0.0}
    closed_by_anchor, closed_by_guides = set(), set()

    def key(state, i):
        return g[state] + w1 * heuristics[i](state)

    opened = [{start: key(start, i)} for i in range(len(heuristics))]

    def least(i):
        return min(opened[i].values(), default=INF)

    def expand(i):
        state = min(opened[i], key=opened[i].get)
        for others in opened:
            others.pop(state, None)
        for _, reached, cost in successors(state):
            if g[state] + cost >= g.get(reached, INF):
                continue
            g[reached] = g[state] + cost
            if reached in closed_by_anchor:
                continue
            opened[0][reached] = key(reached, 0)
            if reached not in closed_by_guides:
                for j in range(1, len(heuristics)):
                    if key(reached, j) <= w2 * key(reached, 0):
                        opened[j][reached] = key(reached, j)
                    else:
                        opened[j].pop(reached, None)  # its previous key is too large as well
        return state

    while least(0) < INF:
        for i in range(1, len(heuristics)):
            if least(i) <= w2 * least(0) and least(i) < INF:
                if g[goal] <= least(i):
                    return g[goal], [len(closed_by_anchor), len(closed_by_guides)]
                closed_by_guides.add(expand(i))
            else:
                if g[goal] <= least(0):
                    return g[goal], [len(closed_by_anchor), len(closed_by_guides)]
                closed_by_anchor.add(expand(0))
    return INF, [len(closed_by_anchor), len(closed_by_guides)]
