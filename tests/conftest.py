"""Hypothesis profiles: new examples in manual runs, fixed examples in continuous integration."""

import os

from hypothesis import Phase, settings

settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None)
# Mutation testing asks only whether an example fails.
phases = Phase.explicit, Phase.generate
settings.register_profile("mutants", deadline=None, derandomize=True, database=None, phases=phases)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE") or ("ci" if os.environ.get("CI") else "default"))
