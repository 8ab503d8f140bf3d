"""A small trained run, data alone: what `cagesdf view --demo` and `load_run("demo")` open. `make demo` makes it."""

from pathlib import Path

DEMO = Path(__file__).parent  # run/ and its generator of new cuboids, programs/
