"""How much memory a process may take for data. Not tracked: it decides how work is done."""

import os
import re

from pipeline.errors import SettingError

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
SHARE = 0.5  # of the machine's memory, where nothing is said


def memory() -> int:
    """Bytes that data may take: CAGESDF_MEMORY, such as 500M or 8G, or half the machine's memory."""
    value = os.environ.get("CAGESDF_MEMORY", "")
    if not value:
        return int(SHARE * installed())
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([KMGT]?)B?", value.strip().upper())
    if not match:
        raise SettingError(f"CAGESDF_MEMORY: wanted a size such as 500M or 8G, got {value!r}")
    return int(float(match[1]) * UNITS[match[2]])


def installed() -> int:
    """Bytes of the machine's memory; 8 GB where the system doesn't say."""
    if not hasattr(os, "sysconf"):
        return 8 * 2**30
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
