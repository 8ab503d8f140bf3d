"""Signed distances by ours and by other libraries: how fast, and how far from the truth.

    pip install point-cloud-utils mesh-to-sdf embreex rtree
    python -m benchmarks.signed_distance        # without a display: PYOPENGL_PLATFORM=egl python …

prints a Markdown table. All get the same points, half of them uniform in the cube, half near the surface of a chair of
overlapping parts (chair.py). They are asked twice: with the parts' faces taken together, as most users do, and
with the surface of the parts' union. Each runs in a process of its own on one core; one that is not installed or
fails is a row that says why. Rates are by processor time and include what a library builds first. The truth is the
exact winding number of each part, and the distance to the surface of the exact union.
"""

import argparse
import json
import sys
from collections.abc import Callable

import numpy as np

from benchmarks import child
from benchmarks.chair import chair
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, join, sample_surface
from cagesdf.geometry.solid import union
from cagesdf.training.precision import processor

JUDGED = 5000  # points whose truth is found
FEW = 4000  # points that slow ones are asked
ON_SURFACE = 1e-6  # nearer points have no side


def ours(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    return SurfaceDistance(union(parts)).signed(points)


def libigl(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    import igl

    mesh = join(parts)
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    return igl.signed_distance(points, mesh.vertices, mesh.faces.astype(np.int64), kind)[0]


def point_cloud_utils(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    import point_cloud_utils as pcu

    mesh = join(parts)
    return pcu.signed_distance_to_mesh(points, mesh.vertices, mesh.faces)[0]


def trimesh(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    from trimesh import Trimesh
    from trimesh.proximity import signed_distance

    mesh = join(parts)
    return -signed_distance(Trimesh(mesh.vertices, mesh.faces, process=False), points)


def mesh_to_sdf(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    from mesh_to_sdf import mesh_to_sdf
    from trimesh import Trimesh

    mesh = join(parts)
    return mesh_to_sdf(Trimesh(mesh.vertices, mesh.faces, process=False), points)


def mesh_to_sdf_sampled(parts: list[Mesh], points: np.ndarray) -> np.ndarray:
    from mesh_to_sdf import mesh_to_sdf
    from trimesh import Trimesh

    mesh = join(parts)
    tri = Trimesh(mesh.vertices, mesh.faces, process=False)
    return mesh_to_sdf(tri, points, surface_point_method="sample", sign_method="normal")


Method = Callable[[list[Mesh], np.ndarray], np.ndarray]
METHODS: dict[str, tuple[str, Method]] = {
    "ours": ("cagesdf", ours),
    "igl": ("libigl, `signed_distance` by fast winding numbers", libigl),
    "pcu": ("point-cloud-utils", point_cloud_utils),
    "scan": ("mesh-to-sdf, scans (its default; OpenGL)", mesh_to_sdf),
    "sample": ("mesh-to-sdf, sampled points and normals", mesh_to_sdf_sampled),
    "trimesh": ("trimesh, `proximity.signed_distance`", trimesh),
}
SLOW = {"trimesh"}


def queries(solid: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Half uniform in the cube, half near the surface, mixed."""
    cube = rng.uniform(-HALF_EXTENT, HALF_EXTENT, (count // 2, 3))
    near = sample_surface(solid, count - len(cube), rng)[0] + rng.normal(size=(count - len(cube), 3)) / 60
    return rng.permutation(np.concatenate([cube, near]))


def truth(parts: list[Mesh], solid: Mesh, points: np.ndarray) -> np.ndarray:
    """Exact winding numbers by part, exact distances to the union."""
    import igl

    windings = [igl.winding_number(part.vertices, part.faces.astype(np.int64), points) for part in parts]
    inside = np.max(windings, axis=0) > 0.5
    distance = np.sqrt(igl.point_mesh_squared_distance(points, solid.vertices, solid.faces.astype(np.int64))[0])
    return np.where(inside, -distance, distance)


def measure(name: str, given: str, faces: int, count: int, repetitions: int) -> dict[str, float]:
    """One library's figures on one input."""
    child.to_one_core()
    parts = list(chair(faces)[0].values())
    solid = union(parts)
    points = queries(solid, count, np.random.default_rng(0))
    exact = truth(parts, solid, points[:JUDGED])
    asked = points[: FEW if name in SLOW else count]
    meshes = parts if given == "parts" else [solid]
    method = METHODS[name][1]
    answers: list[np.ndarray] = []
    seconds = child.seconds(lambda: answers.append(method(meshes, asked)), repetitions)
    answer = np.asarray(answers[0], dtype=np.float64)[:JUDGED]
    exact = exact[: len(answer)]
    sided = np.abs(exact) > ON_SURFACE
    error = np.abs(np.abs(answer) - np.abs(exact))
    return {
        "points": len(asked),
        "rate": len(asked) / seconds,
        "sign": float(((answer < 0) != (exact < 0))[sided].mean()),
        "off": float((error > 1e-4).mean()),
        "largest": float(error.max()),
        "memory": child.peak(),
    }


def row(name: str, given: str, figures: dict[str, float] | str) -> str:
    """A line of the table."""
    start = f"| {METHODS[name][0]} | {given} | "
    if isinstance(figures, str):
        return f"{start}{figures} | | | | | |"
    return (
        f"{start}{figures['points']:,} | {figures['rate']:,.0f} | {figures['sign']:.2%} | {figures['off']:.2%} "
        f"| {figures['largest']:.1e} | {figures['memory']:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faces", type=int, default=39_000)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--only", nargs=2, metavar=("METHOD", "INPUT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.only:
        name, given = args.only
        print(json.dumps(measure(name, given, args.faces, args.points, args.repetitions)))
        return
    rows = []
    for given in ("parts", "union"):
        for name in METHODS:
            options = "--faces", args.faces, "--points", args.points, "--repetitions", args.repetitions
            rows.append(row(name, given, child.ask(__file__, "--only", name, given, *options)))
            print(rows[-1], file=sys.stderr)
    header = "| library | given | points | points/s | wrong sign | distance off by > 1e-4 | by at most | peak MB |"
    print(f"On {processor()}.\n")
    print(child.table(header, rows))


if __name__ == "__main__":
    main()
