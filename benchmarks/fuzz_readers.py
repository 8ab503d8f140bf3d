"""Mutated files through the readers, thousands of each format of tests/support/mutants.py.

    python -m benchmarks.fuzz_readers [FORMAT …] [--count 10000] [--seed 0]

prints a row for each format: how many were read and refused, the longest time and the most memory that one took. A
mutant that raises anything else, or takes longer than SECONDS, is kept in the folder that the last line names; the
exit status is 1 then.
"""

import argparse
import faulthandler
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from cagesdf.errors import InputError, ShapeRejected
from tests.support import mutants

SECONDS = 10.0  # a reader may take for one file
HANG = 60  # seconds after which a reader is ended, with its traceback


def outcome(read, path: Path) -> str:
    try:
        read(path)
    except (InputError, ShapeRejected):
        return "refused"
    except Exception:
        traceback.print_exc()
        return "raised"
    return "read"


def fuzz(name: str, count: int, seed: int, kept: Path) -> Counter[str]:
    rng = np.random.default_rng([seed, *name.encode()])
    chosen = mutants.FORMATS[name]
    files = sorted(chosen.files().items())
    outcomes, longest = Counter[str](), 0.0
    for i in range(count):
        file, content = files[i % len(files)]
        path = kept / f"{name}_{i}_{file}"
        path.write_bytes(mutants.mutant(content, rng))
        faulthandler.dump_traceback_later(HANG, exit=True)
        start = time.perf_counter()
        result = outcome(chosen.read, path)
        seconds = time.perf_counter() - start
        faulthandler.cancel_dump_traceback_later()
        longest = max(longest, seconds)
        outcomes[result] += 1
        outcomes["slow"] += seconds > SECONDS
        if result != "raised" and seconds <= SECONDS:
            path.unlink()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    numbers = [outcomes[key] for key in ("read", "refused", "raised", "slow")]
    print("|", " | ".join([name, *(f"{n:,}" for n in numbers), f"{longest:.2f}", f"{memory:.0f}"]), "|", flush=True)
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(mutants.FORMATS))
    parser.add_argument("--count", type=int, default=10_000, help="of each format")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    kept = Path(tempfile.mkdtemp(prefix="mutants-"))
    print("| format | read | refused | raised | slow | longest, s | peak memory, MiB |")
    print("|---|---|---|---|---|---|---|")
    wrong = 0
    for name in options.formats or mutants.FORMATS:
        outcomes = fuzz(name, options.count, options.seed, kept)
        wrong += outcomes["raised"] + outcomes["slow"]
    if wrong:
        sys.exit(f"{wrong} mutants are in {kept}")
    kept.rmdir()


if __name__ == "__main__":
    main()
