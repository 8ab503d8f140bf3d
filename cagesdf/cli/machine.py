"""The machine that a command runs on."""

import os

from cagesdf.errors import InputError


def workers() -> int:
    """Threads for networks: CAGESDF_WORKERS, as for stages, or one a core. Changes no result."""
    value = os.environ.get("CAGESDF_WORKERS", "")
    if not value:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not value.isdigit() or int(value) < 1:
        raise InputError(f"CAGESDF_WORKERS: wanted a positive number, got {value!r}")
    return int(value)
