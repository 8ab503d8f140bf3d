"""The command that opens the editor."""

import time
from pathlib import Path

from cagesdf.cli.machine import workers
from cagesdf.cli.telling import working
from cagesdf.demo import DEMO
from cagesdf.errors import InputError


def view(
    *runs: Path,
    demo: bool = False,
    shape: str | None = None,
    programs: Path | None = None,
    shapes: Path | None = None,
    host: str = "127.0.0.1",
    port: int | None = None,
) -> None:
    """Edit shapes in the browser: drag the cuboids, slide the style, see the surface. Ctrl-C ends it.

    Parameters
    ----------
    runs
        Folders that `train` wrote, such as data/runs/chair/cagesdf; the first is opened, the others are in a list.
    demo
        Take the small trained run that comes with the project instead.
    shape
        The shape to begin with; without it the first one.
    programs
        A folder that `train_programs` wrote, for new shapes; without it, data/programs/chair for the run above, if
        it is there.
    shapes
        A folder that `import_shapes` wrote, for true surfaces to compare with; without it, data/shapes/chair, if it
        is there.
    host
        The address to listen at. Whoever can reach it can use it: others than the default open it to the network.
    port
        The port to listen at, 0 for any free one; without it the first free one from 8080.
    """
    if demo == bool(runs):
        raise InputError("wanted a RUN, such as data/runs/chair/cagesdf, or --demo")
    if len(runs) > 1 and (shape or programs or shapes):
        raise InputError("--shape, --programs and --shapes are those of one run; wanted one RUN with them")
    if demo:
        programs = programs or DEMO / "programs"
    import torch

    from cagesdf.api.sources import IMPORT
    from cagesdf.inference.shapes import usual_settings
    from cagesdf.viewing.opening import named, opened
    from cagesdf.viewing.server import free_port, serving

    port = free_port(host, port)
    torch.set_num_threads(1)
    folders = {"demo": DEMO / "run"} if demo else named(runs)
    with working(f"reading {', '.join(folders)}"):
        tabs = {
            name: opened(folder, shape, programs, shapes, IMPORT, usual_settings()) for name, folder in folders.items()
        }
    with serving(tabs, host, port, workers()) as editor:
        print(f"The editor: {editor.address}  (Ctrl-C ends it)", flush=True)
        while True:
            time.sleep(3600)
