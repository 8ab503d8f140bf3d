"""The exceptions: a shape that can't be used, and input that is not as it must be."""

SHOWN = 120  # characters of a line that a message quotes


class ShapeRejected(Exception):
    """A shape that a stage can't use.

    `parallel_map` collects it and the stage writes it to `rejected.parquet`: one row per
    shape, with the stage and the reason. `reason` says what came, what was wanted and,
    where known, what to do. Names of files that are no text are escaped in it, so that any table can hold it.
    """

    def __init__(self, shape_id: str, stage: str, reason: str) -> None:
        reason = reason.encode("utf-8", "backslashreplace").decode("utf-8")
        super().__init__(shape_id, stage, reason)
        self.shape_id = shape_id
        self.stage = stage
        self.reason = reason

    def __str__(self) -> str:
        return f"shape {self.shape_id}, {self.stage}: {self.reason}"


class InputError(ValueError):
    """Something from outside (a file, an argument, an artefact) that is not as it must be.

    The message is for the person at the keyboard: what came, what was wanted, which item,
    and what to do. It ends a stage or a command.
    """


class ProgramError(InputError):
    """A ShapeAssembly program that can't be read or executed."""

    def __init__(self, source: str, line: int, text: str, wanted: str) -> None:
        super().__init__(source, line, text, wanted)
        self.source = source  # file name or other origin
        self.line = line  # from 1; 0 where it is no single line
        self.text = text  # of the line
        self.wanted = wanted

    def __str__(self) -> str:
        where = f"{self.source}, line {self.line}" if self.line else self.source
        text = self.text if len(self.text) <= SHOWN else f"{self.text[:SHOWN]}…"
        return f"{where}: {text}: {self.wanted}" if text else f"{where}: {self.wanted}"


class NotSolidError(ValueError):
    """A part that no step of the repair makes closed; the message says why and what to do."""
