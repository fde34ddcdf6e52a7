"""Settings of hypothesis for this folder: no timing, few examples every day, many with HYPOTHESIS_PROFILE=soak."""

import os

from hypothesis import settings

settings.register_profile("everyday", deadline=None, max_examples=50)
settings.register_profile("soak", deadline=None, max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "everyday"))
