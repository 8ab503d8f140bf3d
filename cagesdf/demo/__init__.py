"""A small trained run, data alone: what `cagesdf view --demo` opens. `make demo` makes it."""
