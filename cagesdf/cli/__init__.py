"""The `cagesdf` command: look into artefacts, run programs, take surfaces out of trained networks and edit them.

A file a family of commands; what they need is imported when they are called, so that the others start at once.
"""

import os
import sys
from importlib.metadata import version

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
for command in (view, inspect, extract, edit, swap, mix, fit, generate, signature, check, parts, sdf, plan):
    app.command(command)
app.command(execute_programs, name="execute")


def run() -> None:
    """Run the command line. What is wrong with input is said in one line on standard error, with exit status 1."""
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except BrokenPipeError:
        # Who read the output has seen enough; what is still buffered must go somewhere when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (cyclopts.CycloptsError, InputError, ShapeRejected, OSError) as error:
        text = " ".join(str(error).split())
        sys.exit(f"cagesdf: {text}{' See cagesdf --help.' if isinstance(error, cyclopts.CycloptsError) else ''}")
    except KeyboardInterrupt:
        sys.exit("cagesdf: interrupted")
