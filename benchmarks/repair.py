"""Results of the repair chain on shapes that were broken on purpose: the table of docs/repair.md.

    python -m benchmarks.repair [--points 20000]

prints a row for each case of tests/support/broken.py; definitions in docs/repair.md.
"""

import argparse

from cagesdf.errors import ShapeRejected
from cagesdf.importing import verdict
from tests.support import broken


def row(case: broken.Case, count: int) -> list[str]:
    faces = f"{sum(len(mesh.faces) for mesh in case.broken):,}"
    try:
        shape, errors = broken.measure(case, count)
    except ShapeRejected as rejected:
        return [case.name, faces, f"rejected: {rejected.reason}", *["–"] * 5]
    signs = [f"{errors.sign:.3%}", f"{errors.sign_near:.3%}"]
    distances = [f"{errors.mean:.1e}", f"{errors.worst:.1e}"]
    return [case.name, faces, verdict(shape), *signs, *distances, f"{errors.seconds:.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=20_000, help="in the box, and as many near the surface")
    count = parser.parse_args().points
    print("| broken | faces | what became of it | sign error | near the surface | distance error | at most | s |")
    print("|---|---|---|---|---|---|---|---|")
    for case in [*broken.cases(), broken.million()]:
        print(f"| {' | '.join(row(case, count))} |", flush=True)


if __name__ == "__main__":
    main()
