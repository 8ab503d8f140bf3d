"""The `cagesdf` command: look into artefacts, run programs, take surfaces out of trained networks and edit them.

One file per family of commands. Libraries are imported when a command is called, so that `--help` starts at once.
"""

import os
import re
import sys
from importlib.metadata import PackageNotFoundError, requires, version

import cyclopts

from cagesdf.cli.fitting import fit
from cagesdf.cli.generating import generate
from cagesdf.cli.inspecting import inspect
from cagesdf.cli.planning import plan
from cagesdf.cli.programs import execute_programs, signature
from cagesdf.cli.shapes import check, parts, sdf
from cagesdf.cli.surfaces import edit, extract, mix, swap
from cagesdf.cli.viewing import view
from cagesdf.errors import InputError, ShapeRejected

app = cyclopts.App(
    "cagesdf",
    help="Neural implicit shapes with explicit bounding cuboids.",
    version=lambda: version("cagesdf"),
    version_flags=["--version"],
)
CALLED = {"yaml": "pyyaml", "ruamel": "ruamel.yaml", "skimage": "scikit-image"}  # packages, by their modules' names
for command in (view, inspect, extract, edit, swap, mix, fit, generate, signature, check, parts, sdf, plan):
    app.command(command)
app.command(execute_programs, name="execute")


def run() -> None:
    """Run the command line. What is wrong with input is said in one line on standard error, with exit status 1."""
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except BrokenPipeError:
        # The reader of the output has left; text that is still buffered must go somewhere when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (cyclopts.CycloptsError, InputError, ShapeRejected, OSError) as error:
        text = " ".join(str(error).split())
        sys.exit(f"cagesdf: {text}{' See cagesdf --help.' if isinstance(error, cyclopts.CycloptsError) else ''}")
    except ModuleNotFoundError as error:
        if (extra := _extra(error.name)) is None:
            raise
        sys.exit(f"cagesdf: this needs {error.name}, which isn't installed; pip install 'cagesdf[{extra}]'")
    except KeyboardInterrupt:
        sys.exit("cagesdf: interrupted")


def _extra(module: str | None) -> str | None:
    """The extra that a module comes with, according to the installed package; None if it has none."""
    try:
        requirements = requires("cagesdf") or []
    except PackageNotFoundError:
        return None
    name = (module or "").split(".")[0].lower()
    for requirement in requirements:
        matched = re.match(r"""([\w.-]+).*\bextra == ["']([\w-]+)["']""", requirement)
        if matched and matched[1].lower() == CALLED.get(name, name):
            return matched[2]
    return None
