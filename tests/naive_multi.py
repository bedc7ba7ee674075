"""Textbook twin of the multi-heuristic search: guides first, then shared MHA*; on any graph, slow and simple.

Source: Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016, algorithm SMHA*. Differences: the guides search for
a first plan alone, and the anchor's keys are not inflated; the guides' keys stay below w1 w2 times the anchor's.
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
    heuristics, weights = [anchor, *guides], [1.0] + [w1] * len(guides)
    g = {goal: INF, start: 0.0}
    waiting = {start}
    closed_by_anchor, closed_by_guides = set(), set()

    def key(state, i):
        return g[state] + weights[i] * heuristics[i](state)

    opened = [{start: key(start, i)} for i in range(len(heuristics))]

    def least(i):
        return min(opened[i].values(), default=INF)

    def expand(i):
        state = min(opened[i], key=opened[i].get)
        for others in opened:
            others.pop(state, None)
        waiting.discard(state)
        for _, reached, cost in successors(state):
            if g[state] + cost >= g.get(reached, INF):
                continue
            g[reached] = g[state] + cost
            waiting.add(reached)
            if reached in closed_by_anchor:
                continue
            opened[0][reached] = key(reached, 0)
            if reached not in closed_by_guides:
                for j in range(1, len(heuristics)):
                    opened[j][reached] = key(reached, j)
        return state

    def counts():
        return [len(closed_by_anchor), len(closed_by_guides)]

    turn = 0
    while g[goal] > least(1 + turn % len(guides)):
        closed_by_guides.add(expand(1 + turn % len(guides)))
        turn += 1
    if g[goal] <= w1 * w2 * min((key(state, 0) for state in waiting), default=INF):
        return g[goal], counts()
    while least(0) < INF:
        for i in range(1, len(heuristics)):
            if least(i) <= w1 * w2 * least(0) and least(i) < INF:
                if g[goal] <= least(i):
                    return g[goal], counts()
                closed_by_guides.add(expand(i))
            else:
                if g[goal] <= w1 * w2 * least(0):
                    return g[goal], counts()
                closed_by_anchor.add(expand(0))
    return INF, counts()
