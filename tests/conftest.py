"""One thread a process, since pytest-xdist runs one a core; hypothesis without clocks, the same examples every time."""

import os

from hypothesis import HealthCheck, settings

for name in ("OMP_NUM_THREADS", "IGL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# A busy machine is no failure, and a run must not fail by chance: new examples come with a change of the test.
settings.register_profile("project", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")
