"""One thread a process: pytest-xdist runs a process a core, and threads that wait for each other slow all of them."""

import os

for name in ("OMP_NUM_THREADS", "IGL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
