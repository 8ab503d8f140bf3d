"""The command that says what a run will cost."""

from pathlib import Path
from tempfile import TemporaryDirectory

from cagesdf.errors import InputError


def plan(*, profile: str | None = None) -> None:
    """Say what a run will cost: shapes, points, and disk, memory and time of each stage on this machine.

    Runs the stages on two shapes a category, which takes a minute or two, and scales that up. The paper's network takes
    a quarter of an hour.

    Parameters
    ----------
    profile
        One of profiles/, such as paper; without it, the default run.
    """
    try:
        from pipeline.errors import PipelineError
        from pipeline.planning import plan as estimated
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] == "pipeline":
            raise InputError(
                "plan runs the stages, which are in the repository and not in the package; clone it, and there: "
                "pip install -e '.[pipeline]'"
            ) from error
        raise
    try:
        with TemporaryDirectory() as folder:
            print("\n".join(estimated(profile, Path(folder))))
    except PipelineError as error:
        raise InputError(str(error)) from error
