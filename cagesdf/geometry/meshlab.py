"""Pymeshlab's filters in a process of their own: some meshes keep it busy for hours, or crash it.

    python -m cagesdf.geometry.meshlab SECONDS alpha_wrap ALPHA OFFSET
    python -m cagesdf.geometry.meshlab SECONDS self_union

reads a mesh from standard input and writes another to standard output, both as `_packed`. Only
this process imports pymeshlab, so what happens to it is a part that can't be used, not the end of a run.
"""

import io
import os
import signal
import subprocess
import sys

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.errors import InputError, NotSolidError

MISSING = 3  # exit status: pymeshlab, or the system libraries of its plugins, are not there
INSTALL = "repairing it needs pymeshlab's system libraries: apt-get install libgl1 libopengl0 libegl1"
PATIENCE = 20  # times the allowed CPU time that a process may take on a busy machine
NEEDED = {"alpha_wrap": "generate_alpha_wrap", "self_union": "generate_boolean_union"}  # filters


def alpha_wrap(
    vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"], alpha: float, offset: float, seconds: int
) -> tuple[Float[ndarray, "w 3"], Int[ndarray, "g 3"]]:
    """Vertices and faces of a closed surface `offset` outside the given faces; it enters openings wider than `alpha`.

    CGAL's; lengths are in the vertices' unit. Raises NotSolidError and InputError as `_run` does.
    """
    return _run(seconds, ["alpha_wrap", repr(alpha), repr(offset)], vertices, faces)


def self_union(
    vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"], seconds: int
) -> tuple[Float[ndarray, "w 3"], Int[ndarray, "g 3"]]:
    """The outer surface of a closed mesh that runs into itself: around all that has a winding number above 0.

    libigl's, with exact arithmetic. Raises NotSolidError and InputError as `_run` does.
    """
    return _run(seconds, ["self_union"], vertices, faces)


def _run(
    seconds: int, work: list[str], vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"]
) -> tuple[Float[ndarray, "w 3"], Int[ndarray, "g 3"]]:
    """The mesh that the process makes of another one.

    It is killed after `seconds` of CPU time: time on the clock would make results depend on what
    else runs. Raises NotSolidError if it was killed, crashed or failed, InputError with the line
    that installs them if system libraries are missing.
    """
    command = [sys.executable, "-m", __name__, str(seconds), *work]
    # The process finds this package wherever ours did.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            command, input=_packed(vertices, faces), capture_output=True, timeout=PATIENCE * seconds, env=environment
        )
    except subprocess.TimeoutExpired as error:
        raise NotSolidError(f"its {work[0]} took more than {PATIENCE * seconds} s; simplify it") from error
    message = done.stderr.decode(errors="replace").strip()[-200:]
    if done.returncode == MISSING:
        raise InputError(f"{INSTALL} ({message})")
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        limit = f" after {seconds} s" if name in ("SIGXCPU", "SIGKILL") else ""
        raise NotSolidError(f"its {work[0]} was ended{limit} ({name}); simplify or repair it")
    if done.returncode:
        raise NotSolidError(f"its {work[0]} failed ({message}); export it again")
    return _unpacked(done.stdout)


def _packed(vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"]) -> bytes:
    content = io.BytesIO()
    np.savez(content, vertices=vertices, faces=faces)
    return content.getvalue()


def _unpacked(content: bytes) -> tuple[Float[ndarray, "v 3"], Int[ndarray, "f 3"]]:
    arrays = np.load(io.BytesIO(content), allow_pickle=False)
    return arrays["vertices"], arrays["faces"]


def _work(seconds: int, name: str, lengths: list[float]) -> None:
    """Body of the process: limit its time, read a mesh, apply one filter, write the result."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    # Output that libraries print must not get between the bytes of the answer.
    answer = os.dup(1)
    os.dup2(2, 1)
    try:
        import pymeshlab
    except ImportError as error:
        print(error, file=sys.stderr)
        sys.exit(MISSING)
    meshes = pymeshlab.MeshSet(verbose=False)
    # A plugin whose libraries are missing is left out without an error.
    if not hasattr(meshes, NEEDED[name]):
        print(f"pymeshlab has no {NEEDED[name]}", file=sys.stderr)
        sys.exit(MISSING)
    meshes.add_mesh(pymeshlab.Mesh(*_unpacked(sys.stdin.buffer.read())))
    if name == "alpha_wrap":
        alpha, offset = map(pymeshlab.PureValue, lengths)
        meshes.generate_alpha_wrap(alpha=alpha, offset=offset)
    else:
        meshes.generate_boolean_union(first_mesh=0, second_mesh=0)
    mesh = meshes.current_mesh()
    with os.fdopen(answer, "wb") as stream:
        stream.write(_packed(mesh.vertex_matrix(), mesh.face_matrix()))


if __name__ == "__main__":
    _work(int(sys.argv[1]), sys.argv[2], [float(word) for word in sys.argv[3:]])
