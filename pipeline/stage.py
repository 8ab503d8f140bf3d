"""From a command line to a stage's `main`."""

import argparse
import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path

from pipeline.errors import PipelineError
from pipeline.params import load


def run_stage(main: Callable[..., None], answers: type[Exception]) -> None:
    """Call `main` with the paths on the command line and the parameters of its section.

    Positional arguments are `main`'s, in its order and of the types it annotates (paths, names);
    the last, `params`, is read from `params.yaml` in this folder: from the section that is named
    like the stage, or the one after `--params`. What is wrong with paths, parameters or data is said in one line, exit
    status 1: a PipelineError, an OSError or one of `answers`; `CAGESDF_TRACEBACK=1` shows where it came from. Every
    other exception is a defect and keeps its traceback.
    """
    file = Path(inspect.getfile(main))
    parser = argparse.ArgumentParser(
        prog=f"python -m stages.{file.stem}",
        description=sys.modules[main.__module__].__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    types = {name: item.annotation for name, item in inspect.signature(main).parameters.items() if name != "params"}
    for name, kind in types.items():
        parser.add_argument(name, type=kind)
    parser.add_argument("--params", default=file.stem, help="section of params.yaml (default: the stage's name)")
    arguments = parser.parse_args()
    try:
        main(*(getattr(arguments, name) for name in types), params=load(arguments.params))
    except (PipelineError, OSError, answers) as error:
        if os.environ.get("CAGESDF_TRACEBACK"):
            raise
        sys.exit(f"{file.stem}: {error}")
    except KeyboardInterrupt:
        sys.exit(f"{file.stem}: interrupted")
