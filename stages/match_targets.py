"""Choose the target of each training shape's deformation (§3.3).

python -m stages.match_targets data/shapes/chair data/cuboids/chair data/matches/chair
"""

from pathlib import Path

from cagesdf.deformation.matching import group_by_structure, match_to_one_of, match_to_scaled
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.io.cuboids import read_cages
from cagesdf.io.matches import write_matches
from cagesdf.io.rejected import write_rejected
from cagesdf.io.shapes import read_shapes
from cagesdf.seeds import item_rng
from pipeline import MatchParams, artefact, progress, run_stage
from pipeline.cost import Cost, sequences

COST = Cost("sequences", sequences, {"unmatched": "scale"})  # so few have no partners


def main(shapes: Path, cuboids: Path, out: Path, params: MatchParams) -> None:
    """Read `shapes/` and `cuboids/`, write `matches/`; validation shapes take no part."""
    with artefact.write("matches", out, inputs={"shapes": shapes, "cuboids": cuboids}, params=params) as folder:
        source, cages = read_shapes(shapes), read_cages(cuboids)
        structures = {shape_id: source.structure(shape_id) for shape_id in source.ids_of("train") if shape_id in cages}
        partners = group_by_structure(structures, cages)

        matches, rejected = [], []
        for shape_id, others in progress(partners.items(), total=len(partners), label="match_targets"):
            rng = item_rng(params.seed, "match_targets", shape_id)
            if others:
                matches.append(match_to_one_of(shape_id, others, structures, cages, rng))
            elif params.unmatched == "scale":
                matches.append(match_to_scaled(shape_id, cages[shape_id], params.scale, rng))
            else:
                rejected.append(ShapeRejected(shape_id, "match_targets", "no other training shape of equal structure"))
        write_matches(folder, matches)
        write_rejected(folder, rejected, len(partners), params.max_rejected)


if __name__ == "__main__":
    run_stage(main, InputError)
