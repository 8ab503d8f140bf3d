"""Errors that are shown to the user in one line, without a traceback."""


class PipelineError(Exception):
    """Something from outside that is not as it must be; the message says what came, what was wanted, what to do."""


class SettingError(PipelineError):
    """An environment variable that can't be used."""


class WorkerError(PipelineError):
    """Processes that can't be reached or don't survive an item: no cluster, other code, too little memory."""
