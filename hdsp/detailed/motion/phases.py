"""Motion phases."""

#: ``roll``: all feet on the ground, driving, turning or moving under the base; ``lean``: the base moves over resting
#: feet; ``lift``, ``swing``, ``lower``: parts of a step.
PHASES = ("roll", "lean", "lift", "swing", "lower")
