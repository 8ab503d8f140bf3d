"""The page says what the tables and pictures say, and asks for nothing from the network."""

import json
import re
import xml.etree.ElementTree
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cagesdf import rendering
from cagesdf.cage_fitting.cages import FittedCage
from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.deformation.sequences import deform_shape, scaled_cage
from cagesdf.errors import InputError, ShapeRejected
from cagesdf.evaluation.edits import FIGURES
from cagesdf.evaluation.metrics import OF_KEY, PROGRESS
from cagesdf.evaluation.shape_sets import FIGURES as GENERATION
from cagesdf.evaluation.table3 import REAL, gather_generation
from cagesdf.evaluation.trials import trial_of
from cagesdf.geometry.solid import cage_surface, union
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.edits import write_edit_surfaces, write_edits
from cagesdf.io.generated_shapes import write_generated
from cagesdf.io.generation_scores import write_generation
from cagesdf.io.logs import read_losses
from cagesdf.io.meshes import Surface, write_surfaces
from cagesdf.io.progress import write_progress
from cagesdf.io.rejected import write_rejected
from cagesdf.io.scores import SCORES, write_scores
from cagesdf.io.sequences import read_sequences, write_sequences
from cagesdf.io.shapes import read_shapes, write_shapes
from cagesdf.io.trials import read_trials, write_trials
from cagesdf.rendering import CLAY, Scene
from cagesdf.report import chart, figures
from cagesdf.report.chart import log_chart
from cagesdf.report.gather import mixes, part_colours, read_category, swaps
from cagesdf.report.generated_shapes import failures, opened, strip
from cagesdf.report.page import Category, Grid, write_page
from cagesdf.report.selection import spread
from cagesdf.shape import Shape
from pipeline import Params, ReportParams, artefact
from stages import report
from tests.support import toy

SVG = "{http://www.w3.org/2000/svg}"
STEPS = {"cagesdf": (0, 1), "deepsdf": (0,)}  # that an arm reconstructs
NOTHING = Grid((), (), (), ())
BOUNDING = {"outside_before": 0.25, "outside": 0.00125, "volume_ratio": 1.5, "parts": 40, "unbounded": 3}


def line(mean: float) -> dict[str, dict[str, float]]:
    return {key: {"mean": mean, "std": mean / 10, "n": 2} for key in ("surface_distance", "cd_deepsdf", "iou")}


TABLE = {"chair": {"cagesdf": line(0.5), "deepsdf": line(0.25), "cage": line(0.125), "ground_truth": line(0.0625)}}
NO_EDITS: dict[str, dict[str, object]] = {"about": {}, "categories": {}}
GAIN = {"median": 0.75, "q25": 0.5, "q75": 0.9, "mean": 0.7, "max": 0.95, "positive": 0.9, "n": 67}
MOVED = {"median": 0.0, "q25": 0.0, "q75": 0.0, "mean": 0.25, "max": 1.5, "n": 16}
EDITED = {
    "cagesdf": {"swap": {"gain": GAIN}, "local": {"moved_mean": MOVED}},
    "cagesdf_global": {"swap": {"gain": {**GAIN, "median": 0.25}}},
    "deepsdf": {},
    "box_warp": {"swap": {"gain": {**GAIN, "median": 0.875}}},
}
COURSE = [
    {"points": 10, "held_out": True, "surface_distance": 1.0, "cd_deepsdf": 0.1, "nc_signed": 0.5},
    {"points": 40, "held_out": True, "surface_distance": 0.1, "cd_deepsdf": 0.01, "nc_signed": 0.9},
]
NO_PROGRESS: dict[str, dict[str, object]] = {"about": {}, "categories": {}}
NO_TABLE3 = gather_generation({})
SETS = {"train": 3, "validation": 1, "drawn": 9, "shapes_a_draw": 4, "noise": {"unsquared": 0.0361, "squared": 0.002}}


def method(arm: str, name: str, figure: float) -> dict[str, object]:
    """A row of Table 3."""
    key = {"arm": arm, "method": name, "draw": 0, "shapes": 4, "failed": 0.0, "recognised": 1.0}
    return {**key, **dict.fromkeys(GENERATION, figure)}


METHODS = [
    method("cagesdf", "dependent", 0.123),
    method("deepsdf", "isotropic", 0.456),
    method(REAL, "drawn", 0.078),
]
TABLES = {
    "about": {"version": 1, "points": 30000, "seeds": [0, 1]},
    "table1": TABLE,
    "table2": {"chair": {}},
    "edits": {"about": {}, "categories": {"chair": EDITED}},
    "progress": {"about": {}, "categories": {"chair": dict.fromkeys(("cagesdf", "deepsdf"), COURSE)}},
    "table3": gather_generation({"chair": (METHODS, {"sets": SETS})}),
}


class Page(HTMLParser):
    """Addresses that a page refers to, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.images = 0
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.addresses += [
            value or "" for name, value in attributes if name in ("src", "href", "srcset", "action", "data")
        ]
        self.images += tag == "img"
        assert tag not in ("script", "iframe", "object", "embed", "base")
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture
def category(monkeypatch: pytest.MonkeyPatch) -> Category:
    monkeypatch.setattr(rendering, "WINDOWS", ())
    cage = Cage.of({"a": Cuboid(np.zeros(3), np.eye(3), np.ones(3))})
    surface = Scene((cage_surface(cage),), (CLAY,))
    boxes = Scene(cage=cage, cage_colours=("#336699",))
    comparison = Grid(("cuboids", "ground truth", "cagesdf"), (False,) * 3, ("c<1>",), ((boxes, surface, surface),))
    fitting = Grid(("as given", "fitted"), (False,) * 2, ("c<1>",), ((None, boxes),))
    sequence = Grid(("t = 0.0", "t = 0.5"), (False, True), ("truth", "cagesdf"), ((surface, surface), (None, surface)))
    new = Grid(("rank 50%",), (False,), ("cagesdf, dependent", "nearest training shapes"), ((surface,), (surface,)))
    failed = Grid(("farthest", "most pieces"), (False,) * 2, ("cagesdf, dependent: up to 2 pieces",), ((surface,) * 2,))
    swapped = Grid(("cuboids of", "style of", "cagesdf"), (False,) * 3, ("median gain, 0.75",), ((surface,) * 3,))
    mixed = Grid(("details stretched", "details kept"), (False,) * 2, ("c<1>, leg",), ((surface,) * 2,))
    curve = [(20, 0.1), (40, 0.05), (60, 0.02)]
    return Category(
        "chair",
        5,
        2,
        {"bad": "a <b> part"},
        BOUNDING,
        fitting,
        comparison,
        sequence,
        swapped,
        mixed,
        new,
        failed,
        {"cagesdf": curve, "deepsdf": curve},
    )


@pytest.fixture
def page(category: Category, tmp_path: Path) -> str:
    write_page(tmp_path / "index.html", TABLES, [category], 48, 1)
    return (tmp_path / "index.html").read_text(encoding="utf-8")


def test_the_page_asks_for_nothing_outside_itself(page: str) -> None:
    assert all(address.startswith(("data:", "#", "views/")) for address in Page(page).addresses)
    styles = "".join(re.findall(r"<style>(.*?)</style>", page, re.DOTALL))
    assert "url(" not in styles
    assert "@import" not in styles
    assert "http" not in re.sub(r"data:[^\"]*", "", page)


def test_every_scene_is_a_picture_and_links_inside_the_page_lead_somewhere(page: str) -> None:
    parsed = Page(page)
    assert parsed.open == []
    assert parsed.images == 7 + 3 + 2 + 4
    for address in parsed.addresses:
        assert not address.startswith("#") or f'id="{address[1:]}"' in page


def test_the_page_tells_the_papers_figures_and_that_they_are_not_comparable(page: str) -> None:
    text = " ".join(Page(page).words)
    assert {"0.000845", "0.000447", "Chamfer 0.000617", "Chamfer 0.00274"} <= {
        word.strip() for word in Page(page).words
    }
    assert "Data and compute differ" in text
    assert "V100" in text


def test_names_and_reasons_are_shown_as_written(page: str) -> None:
    text = " ".join(Page(page).words)
    assert "c<1>" in text
    assert "a <b> part" in text
    assert "5 shapes passed" in text
    assert "held out" in text


def test_the_same_input_gives_the_same_page(category: Category, page: str, tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    write_page(tmp_path / "again" / "index.html", TABLES, [category], 48, 1)
    assert (tmp_path / "again" / "index.html").read_text(encoding="utf-8") == page


def test_the_page_says_how_the_cuboids_bound_the_parts(page: str) -> None:
    text = " ".join(" ".join(Page(page).words).split())
    assert "25.00 % lay outside its cuboid before and 0.12 % does now" in text
    assert "3 of 40 parts stick out" in text


def test_the_best_gain_of_the_arms_is_marked_and_who_cannot_be_edited_says_why(page: str) -> None:
    text = " ".join(" ".join(Page(page).words).split())
    assert "The swap of median gain and the one of least gain of the arm cagesdf" in text
    assert "at most 1.5" in text
    assert figures.NOT_EDITED in text
    assert re.search(r'<td class="best">0\.750<small>0\.50 to 0\.90</small>', page)
    assert not re.search(r'class="best">0\.875', page), "a reference"
    table = re.search(r"<h3>Edits</h3>.*?</table>", page, re.DOTALL)
    assert table is not None
    assert "swap, %" not in table.group(), "nobody has that figure"


def test_a_page_without_figures_pictures_or_curves_still_stands(tmp_path: Path) -> None:
    bare = Category("stool", 0, 0, {}, BOUNDING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, {})
    write_page(
        tmp_path / "index.html",
        {"about": {}, "table1": {}, "table2": {}, "edits": NO_EDITS, "progress": NO_PROGRESS, "table3": NO_TABLE3},
        [bare],
        48,
        1,
    )
    parsed = Page((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert parsed.open == []
    assert parsed.images == 0
    assert "stool" in parsed.words
    assert "Novel shapes" not in parsed.words


def test_generated_shapes_are_told_beside_the_papers_and_the_order_of_methods(page: str) -> None:
    text = " ".join(" ".join(Page(page).words).split())
    assert "By FD , the best first: cagesdf, dependent; deepsdf, isotropic." in text.replace("FD,", "FD ,")
    assert "In the paper: dependent; independent; DeepSDF." in text
    assert {"489", "55.0"} <= set(text.split()), "the paper's"
    assert "0.0361 apart" in text
    assert re.search(r'<td class="best">0\.123', page)
    assert not re.search(r'class="best">0\.078', page), "a reference"


def test_the_best_figure_is_the_lowest_distance_and_the_highest_overlap_and_references_never_win() -> None:
    columns = [("chair", "surface_distance"), ("chair", "iou"), ("table", "iou")]
    ours, baseline = figures.rows(TABLE, ["cagesdf", "deepsdf"], columns, ranked=True)
    assert [cell.best for cell in ours.cells] == [False, True, False]
    assert [cell.best for cell in baseline.cells] == [True, False, False]
    assert ours.cells[2].text == "–"
    assert not any(cell.best for row in figures.rows(TABLE, figures.REFERENCES, columns, False) for cell in row.cells)
    assert figures.rows(TABLE, ["unheard_of"], columns, ranked=True) == []


def test_a_metric_that_only_describes_has_no_best_and_no_arrow(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = replace(OF_KEY["surface_distance"], higher=None)
    assert (OF_KEY["iou"].arrow, OF_KEY["surface_distance"].arrow, metric.arrow) == ("↑", "↓", "")
    monkeypatch.setitem(OF_KEY, "surface_distance", metric)
    for row in figures.rows(TABLE, ["cagesdf", "deepsdf"], [("chair", "surface_distance")], ranked=True):
        assert [cell.best for cell in row.cells] == [False]


def test_arms_stand_in_the_order_of_the_ablation_then_by_name() -> None:
    assert figures.in_order({"zebra", "deepsdf", "ground_truth", "ant", "cagesdf_noaug", "cagesdf"}) == [
        "cagesdf", "cagesdf_noaug", "deepsdf", "ant", "zebra",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.000447, "0.000447"), (0.0247, "0.0247"), (12.3456, "12.3"), (99.96, "100"), (0.9996, "1.00"), (0.0, "0"),
        (3e-13, "0"), (1234.5, "1234"), (4.5e-7, "4.50·10⁻⁷"), (float("inf"), "∞"), (float("nan"), "–"), (0.5, "0.500"),
    ],
)  # fmt: skip
def test_figures_have_three_significant_digits(value: float, text: str) -> None:
    assert figures.figure(value) == text


@given(st.floats(1e-5, 1e5), st.sampled_from([2, 3]))
def test_a_written_figure_is_the_number_to_its_digits(value: float, digits: int) -> None:
    assert float(figures.figure(value, digits)) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


def polylines(svg: str) -> list[np.ndarray]:
    root = xml.etree.ElementTree.fromstring(svg)
    lines = [element for element in root.iter() if element.tag.removeprefix(SVG) == "polyline"]
    return [np.array([[float(n) for n in pair.split(",")] for pair in line.attrib["points"].split()]) for line in lines]


def test_equal_ratios_of_losses_are_equal_heights() -> None:
    (curve,) = polylines(log_chart({"a": [(0, 1.0), (1, 0.1), (2, 0.01)]}, "loss"))
    np.testing.assert_allclose(np.diff(curve[:, 1]), np.diff(curve[:, 1])[0], atol=0.2)
    assert (np.diff(curve, axis=0) > 0).all(), "later is right, lower is below"


@given(
    st.dictionaries(
        st.sampled_from("abcdefghij"),
        st.lists(st.tuples(st.integers(0, 10**6), st.floats(allow_nan=True, allow_infinity=True)), max_size=5),
        max_size=10,
    )
)
def test_any_losses_give_a_chart_within_its_frame(curves: dict[str, list[tuple[int, float]]]) -> None:
    svg = log_chart({name: sorted(curve, key=lambda point: point[0]) for name, curve in curves.items()}, "loss")
    usable = [name for name, curve in curves.items() if sum(1e-30 < y < 1e30 for _, y in curve) > 1]
    assert bool(svg) == bool(usable)
    if svg:
        lines = polylines(svg)
        assert len(lines) == len(usable)
        for line in lines:
            assert (line >= 0).all()
            assert (line <= [760, 300]).all()


@given(st.integers(0, 40), st.integers(1, 8))
def test_chosen_shapes_are_different_and_in_order(total: int, count: int) -> None:
    items = [f"{i:02d}" for i in range(total)]
    chosen = spread(items, count)
    assert len(chosen) == min(total, count)
    assert chosen == sorted(set(chosen))


GAINS = (0.9, -1.0, 0.5)  # of the stools' swaps
PARAMS = Params(format=1)
REPORT = ReportParams(
    format=1, shapes=2, generated=2, image_size=32,
    categories=("stool",), arms=("cagesdf", "deepsdf"), generators=("cagesdf",),
)  # fmt: skip


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Artefacts of one category and two arms, one without held-out steps."""
    monkeypatch.setattr(rendering, "WINDOWS", ())
    shapes = [toy.stool(f"stool_{i}", width=1 + 0.2 * i) for i in range(3)]
    folder = tmp_path / "data"
    with artefact.write("shapes", folder / "shapes" / "stool", inputs={}, params=PARAMS) as out:
        write_shapes(out, shapes)
        write_rejected(out, [ShapeRejected("stool_9", "import_shapes", "no faces")], 4, 0.5)
    sequences = []
    for i, shape in enumerate(shapes):
        low, high = (np.array([f(p.mesh.vertices, axis=0) for p in shape.parts]) for f in (np.min, np.max))
        cage = Cage(shape.structure.parts(), (low + high) / 2, np.tile(np.eye(3), (len(low), 1, 1)), high - low)
        cages = tuple(scaled_cage(cage, np.array([1, 1 + 0.1 * i * t, 1])) for t in (0, 1, 2))
        sequences.append(Sequence(shape.shape_id, None, np.array([0, 0.5, 1]), (False, True, False), cages))
    rest = {s.shape_id: s.cages[0] for s in sequences}
    with artefact.write("cuboids", folder / "cuboids" / "stool", inputs={}, params=PARAMS) as out:
        inside = np.zeros(5)
        fits = {
            name: FittedCage(cage, None, inside, inside, inside, inside + 1, 0.0, 0.0) for name, cage in rest.items()
        }
        write_cuboids(out, fits)
    with artefact.write("sequences", folder / "sequences" / "stool", inputs={}, params=PARAMS) as out:
        write_sequences(out, sequences, {s.shape_id: np.zeros((3, 5)) for s in sequences})
    for arm, steps in STEPS.items():
        surfaces = [
            Surface(
                s.shape_id,
                step,
                step == 1,
                union(deform_shape(shape, s.cages[0], s.cages[step])),
                0.0,
                1,
                shape.similarity,
            )
            for shape, s in zip(shapes, sequences)
            for step in steps
        ]
        with artefact.write("meshes", folder / "meshes" / "stool" / arm, inputs={}, params=PARAMS) as out:
            write_surfaces(out, surfaces)
        with artefact.write("run", folder / "runs" / "stool" / arm, inputs={}, params=PARAMS) as out:
            (out / "log.jsonl").write_text(
                '{"step": 20.0, "loss": 0.5}\n{"step": 40.0, "loss": 0.25}\n', encoding="utf-8"
            )
    with artefact.write("edits", folder / "edits" / "stool", inputs={}, params=PARAMS) as out:
        rows = [edit("cagesdf", shapes[i], shapes[i - 1], gain) for i, gain in enumerate(GAINS)]
        write_edits(out / "edits.parquet", rows, {"version": 1})
        write_edit_surfaces(out, {("cagesdf", str(row["trial_id"])): toy.ball([0, 0, 0], 1) for row in rows})
    with artefact.write("trials", folder / "trials" / "stool", inputs={}, params=PARAMS) as out:
        parts = [[part.mesh for part in shape.parts] for shape in shapes]
        trials = [
            trial_of("swap", s.shape_id, s.cages[0], meshes, name=shapes[i - 1].shape_id)
            for i, (s, meshes) in enumerate(zip(sequences, parts))
        ]
        write_trials(out, trials, {"version": 1}, left_out=2)
        write_edits(out / "references.parquet", [edit("unchanged", shapes[0], shapes[2], 0.0)], {"version": 1})
    with artefact.write("progress", folder / "progress" / "stool", inputs={}, params=PARAMS) as out:
        course = [
            {
                "arm": arm,
                "shape_id": "stool_0",
                "step": 1,
                "held_out": arm == "cagesdf",
                **dict.fromkeys(PROGRESS, 1 / points),
            }
            | {"points": points}
            for arm in ("cagesdf", "deepsdf")
            for points in (10, 40)
        ]
        write_progress(out, course, {"version": 1})
    with artefact.write("generated", folder / "generated" / "stool" / "cagesdf", inputs={}, params=PARAMS) as out:
        balls = [toy.ball([0, 0, 0], 0.5 + 0.1 * i) for i in range(3)]
        made = [
            toy.generated("dependent", f"n{i}", ball, np.zeros((0, 3), np.float32), i) for i, ball in enumerate(balls)
        ]
        write_generated(out, made, {})
    with artefact.write("generation", folder / "generation" / "stool", inputs={}, params=PARAMS) as out:
        key = {"arm": "cagesdf", "method": "dependent"}
        near = [{**key, "shape_id": f"n{i}", "nearest": "stool_1", "distance": (3 - i) / 10} for i in range(3)]
        lost = {**key, "shape_id": "n3", "nearest": "", "distance": np.inf}
        write_generation(out, METHODS, [*near, lost], {"sets": SETS})
    measured = [(arm, s.shape_id, step) for arm, steps in STEPS.items() for s in sequences for step in steps]
    references = [("cage", "stool_0", 0), ("ground_truth", "stool_0", 0)]
    write_rows(folder / "scores" / "stool", [*measured, *references])
    return folder


def edit(arm: str, shape: Shape, style: Shape, gain: float) -> dict[str, object]:
    """A row of a swap."""
    key = {"kind": "swap", "shape_id": shape.shape_id, "style_of": style.shape_id}
    trial_id = f"swap/{shape.shape_id}/{style.shape_id}"
    return {"arm": arm, "trial_id": trial_id, **key, **dict.fromkeys(FIGURES, 0.5), "gain": gain}


def write_rows(folder: Path, keys: list[tuple[str, str, int]]) -> None:
    figures_ = dict.fromkeys([*OF_KEY, *(column.name for column in SCORES.columns[5:])], 0.5)
    rows = [{"arm": a, "shape_id": i, "step": k, "held_out": k == 1, "seed": 0, **figures_} for a, i, k in keys]
    with artefact.write("scores", folder, inputs={}, params=PARAMS) as out:
        write_scores(out, rows, {"version": 1})


def make(data: Path, name: str) -> tuple[Path, Path]:
    report.main(data, data / name / "metrics", data / name / "report", REPORT)
    return data / name / "metrics" / "tables.json", data / name / "report" / "index.html"


def test_the_stage_writes_the_tables_and_one_page_the_same_each_time(data: Path) -> None:
    tables, page = make(data, "a")
    content = json.loads(tables.read_text(encoding="utf-8"))
    assert set(content["table1"]["stool"]) == {"cagesdf", "deepsdf", "cage", "ground_truth"}
    assert set(content["table2"]["stool"]) == {"cagesdf"}
    assert content["cuboids"]["stool"] == {
        "outside_before": 0.0, "outside": 0.0, "volume_ratio": 1.0, "parts": 15, "unbounded": 0,
    }  # fmt: skip
    parsed = Page(page.read_text(encoding="utf-8"))
    assert parsed.images == 2 + 2 * 4 + 3 + 3 + 2 + 2 * 4 + 4 + 2, (
        "two shapes fitted and compared; a sequence's cuboids, surfaces, reconstructions; two swaps; "
        "two new shapes with their neighbours, two failures"
    )
    assert content["table3"]["orders"]["stool"]["here"]["fd"] == ["cagesdf, dependent", "deepsdf, isotropic"]
    assert content["edits"]["categories"]["stool"]["cagesdf"]["swap"]["gain"]["median"] == 0.5
    assert content["edits"]["categories"]["stool"]["deepsdf"] == {}
    course = content["progress"]["categories"]["stool"]
    assert [(row["points"], row["held_out"]) for row in course["cagesdf"]] == [(10, True), (40, True)]
    assert [(row["points"], row["surface_distance"]) for row in course["deepsdf"]] == [(10, 0.1), (40, 0.025)]
    assert "Training to quality" in page.read_text(encoding="utf-8")
    assert "but for deepsdf" in page.read_text(encoding="utf-8")
    assert content["trials"] == {"stool": {"swap": 3, "left_out": 2}}
    assert "3 shapes passed" in parsed.words
    assert "no faces" in parsed.words
    for first, again in zip((tables, page), make(data, "b")):
        assert first.read_bytes() == again.read_bytes()


def plain_page(path: Path, tables: object, categories: list[Category], *options: object) -> None:
    """What a page is made of, without pictures."""
    rows = [(category.name, category.comparison.columns, sorted(category.losses)) for category in categories]
    path.write_text(f"{tables}\n{rows}", encoding="utf-8")


def test_leftovers_of_other_runs_change_nothing(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "write_page", plain_page)
    first = make(data, "a")
    renamed = [f"{kind}/stool/renamed" for kind in ("meshes", "runs", "generated")]
    for left in ("shapes/lamp", "meshes/lamp/cagesdf", *renamed):
        (data / left).mkdir(parents=True)
        (data / left / artefact.MANIFEST).write_text("{", encoding="utf-8")
    for before, after in zip(first, make(data, "b"), strict=True):
        assert before.read_bytes() == after.read_bytes()
        assert (before.parent / artefact.MANIFEST).read_bytes() == (after.parent / artefact.MANIFEST).read_bytes()


def test_a_report_that_fails_leaves_the_tables_and_the_page_of_the_last_one(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "write_page", plain_page)
    last = [path.read_bytes() for path in make(data, "a")]
    (data / "scores" / "stool" / "scores.parquet").unlink()
    with pytest.raises(artefact.ArtefactError, match=r"stool: lacks scores\.parquet"):
        make(data, "a")

    def fail(*arguments: object) -> None:
        raise InputError("no picture")

    write_rows(data / "scores" / "stool", [("cagesdf", "stool_0", 0)])
    monkeypatch.setattr(report, "write_page", fail)
    with pytest.raises(InputError, match="no picture"):
        make(data, "a")
    assert [(data / "a" / name).read_bytes() for name in ("metrics/tables.json", "report/index.html")] == last


@given(st.floats(1e-4, 1e7))
def test_numbers_below_a_chart_are_round_begin_at_zero_and_reach_nearly_to_its_end(last: float) -> None:
    ticks = chart._multiples(last)
    step = ticks[1]
    assert ticks[0] == 0
    assert last < ticks[-1] + step * (1 + 1e-6)
    assert ticks[-1] <= last * (1 + 1e-6)
    assert 4 <= len(ticks) <= 10
    assert f"{step:.0e}"[0] in "125"
    assert float(f"{step:.0e}") == pytest.approx(step)


def test_the_sequence_shown_is_the_one_that_moves_most(data: Path) -> None:
    places = {"cagesdf": data / "meshes" / "stool" / "cagesdf"}
    kinds = ("shapes", "cuboids", "sequences", "trials")
    shapes, cuboids, sequences, trials = (data / kind / "stool" for kind in kinds)
    edits, generation = data / "edits" / "stool", data / "generation" / "stool"
    category = read_category(shapes, cuboids, sequences, trials, places, {}, edits, {}, generation, 9, 2)
    assert category.comparison.names == ("stool_0", "stool_1", "stool_2")
    heights = [np.ptp(scene.points()[:, 1]) for scene in category.sequence.scenes[1] if scene]
    assert heights[2] == pytest.approx(1.4 * heights[0])
    assert category.sequence.held_out == (False, True, False)
    assert [scene is None for scene in category.sequence.scenes[2]] == [False, False, True]


def test_the_swaps_shown_are_those_of_median_and_of_least_gain(data: Path, tmp_path: Path) -> None:
    shapes, trials = read_shapes(data / "shapes" / "stool"), read_trials(data / "trials" / "stool")
    grid = swaps(shapes, trials, data / "edits" / "stool")
    assert grid.columns == ("cuboids of", "style of", "cagesdf", "ground truth")
    assert grid.names == (
        "median gain, 0.50: stool_2 in the style of stool_1", "least gain, -1.00: stool_1 in the style of stool_0",
    )  # fmt: skip
    write_edits(tmp_path / "edits.parquet", [], {"version": 1})
    assert swaps(shapes, trials, tmp_path).scenes == ()


def test_the_mixes_shown_are_evenly_spread_by_gain_and_beside_those_with_details_kept(
    data: Path, tmp_path: Path
) -> None:
    source, stools = read_shapes(data / "shapes" / "stool"), [f"stool_{i}" for i in range(3)]
    rest = {name: sequence.cages[0] for name, sequence in read_sequences(data / "sequences" / "stool").items()}
    rows, trials, surfaces = [], [], {}
    for i, (name, gain) in enumerate(zip(stools, GAINS)):
        shape, style = source.read(name), source.read(stools[i - 1])
        for kind, radius in (("mix", 1.0), ("mix_keep", 0.5)):
            trial_id = f"{kind}/{name}/{style.shape_id}"
            rows.append(edit("cagesdf", shape, style, gain) | {"kind": kind, "trial_id": trial_id})
            surfaces["cagesdf", trial_id] = toy.ball([0, 0, 0], radius)
            own = [part.mesh for part in shape.parts]
            key = {"name": style.shape_id, "style_of": style.shape_id, "part_id": "leg0|leg1|leg2|leg3"}
            trials.append(trial_of(kind, name, rest[name], own, **key))
    write_edits(tmp_path / "edits.parquet", rows, {"version": 1})
    write_edit_surfaces(tmp_path, surfaces)
    write_trials(tmp_path, trials, {"version": 1}, left_out=0)
    grid = mixes(source, read_trials(tmp_path), tmp_path)
    assert grid.names == (
        "stool_1, leg in the style of stool_0", "stool_2, leg in the style of stool_1",
        "stool_0, leg in the style of stool_2",
    )  # fmt: skip
    for scenes in grid.scenes:
        stretched, kept = (scene.points() for scene in scenes[2:4] if scene)
        assert np.ptp(stretched, axis=0) == pytest.approx(2 * np.ptp(kept, axis=0))
    write_edits(tmp_path / "edits.parquet", [], {"version": 1})
    assert mixes(source, read_trials(tmp_path), tmp_path).scenes == ()


def test_generated_shapes_are_shown_at_even_ranks_of_their_distance_and_failures_by_a_rule(data: Path) -> None:
    new, figures_ = opened({"cagesdf": data / "generated" / "stool" / "cagesdf"}), data / "generation" / "stool"
    grid = strip(read_shapes(data / "shapes" / "stool"), new, figures_, 3)
    assert grid.columns == ("rank 17%", "rank 50%", "rank 83%")
    assert grid.names == ("cagesdf, dependent", "nearest training shapes")
    radii = [np.linalg.norm(scene.points(), axis=1).max() for scene in grid.scenes[0] if scene]
    assert radii == pytest.approx([0.7, 0.6, 0.5], rel=1e-5), "the last is the nearest"
    worst = failures(new, figures_)
    assert worst.names == ("cagesdf, dependent: up to 2 pieces",)
    radii = [np.linalg.norm(scene.points(), axis=1).max() for scene in worst.scenes[0] if scene]
    assert radii == pytest.approx([0.5, 0.7], rel=1e-5)
    assert [scene is None for scene in strip(read_shapes(data / "shapes" / "stool"), new, figures_, 4).scenes[0]] == [
        False, False, False, True,
    ]  # fmt: skip
    assert strip(read_shapes(data / "shapes" / "stool"), {}, figures_, 3).scenes == ()


def test_parts_of_one_label_share_a_colour_and_unlabelled_parts_have_their_own() -> None:
    seat, *legs = part_colours(toy.stool("a"))
    assert len(set(legs)) == 1
    assert seat != legs[0]
    bare = toy.stool("a")
    parts = tuple(replace(part, label="") for part in bare.parts)
    assert len(set(part_colours(replace(bare, parts=parts)))) == 5


@pytest.mark.parametrize("text", ["{", '{"step": 1}\n', "[1]\n"])
def test_a_damaged_log_is_refused_by_name(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_losses(tmp_path)
    (tmp_path / "log.jsonl").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"log\.jsonl: wanted lines with step and loss"):
        read_losses(tmp_path)
