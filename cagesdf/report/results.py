"""Tables as Markdown: docs/results.md and the README's of the default run, and the metrics' in docs/metrics.md.

    python -m cagesdf.report.results data/metrics/tables.json docs/results.md README.md docs/metrics.md

Those of the README and of docs/metrics.md stand between two comments and are replaced there.
"""

import argparse
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from cagesdf.evaluation.metrics import METRICS
from cagesdf.report.figures import PAPER_HELD_OUT, PAPER_RECONSTRUCTION, in_order

Tables = Mapping[str, Any]  # data/metrics/tables.json
Cells = Iterable[Sequence[str]]
BLOCK = re.compile(r"(?<=<!-- results -->\n).*?(?=<!-- end of results -->)", re.DOTALL)
METRICS_BLOCK = re.compile(r"(?<=<!-- metrics -->\n).*?(?=<!-- end of metrics -->)", re.DOTALL)
SHOWN = ("cagesdf", "cagesdf_global", "deepsdf", "deepsdf_sine", "cage")  # in the README


def results_page(tables: Tables) -> str:
    """The text of docs/results.md."""
    environment = Environment(
        loader=PackageLoader("cagesdf.report", "."),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
    )
    known = {
        "about": tables["about"],
        "sets": next(iter(tables["table3"]["categories"].values()))["sets"],
        "reconstruction": reconstruction(tables),
        "held_out": held_out(tables),
        "surfaces": surfaces(tables),
        "chamfer": chamfer(tables),
        "swaps": gains(tables, {"warp": "warp", "swap": "recipe"}),
        "mixes": gains(tables, {"mix_warp": "warp", "mix": "recipe", "mix_keep": "details kept"}),
        "generation": generation(tables),
    }
    return environment.get_template("results.md.j2").render(known)


def readme_table(tables: Tables) -> str:
    """The README's table: surface distance of source shapes and of held-out steps, and gains of swaps."""
    names = _categories(tables)
    head = ["", *(f"{name}: {of}" for of in ("source", "held-out") for name in names)]
    rows = [
        [f"`{arm}`"]
        + [_spread(tables["table1"][name].get(arm), "surface_distance") for name in names]
        + [_spread(tables["table2"][name].get(arm), "surface_distance") for name in names]
        for arm in SHOWN
    ]
    return markdown(head, rows)


def with_readme_table(readme: str, tables: Tables) -> str:
    """A README with the table of these figures between its two comments. Raises ValueError where there are none."""
    return _with_block(readme, BLOCK, readme_table(tables))


def with_metrics(page: str) -> str:
    """docs/metrics.md with the table of all metrics. Raises ValueError as `with_readme_table`."""
    rows = [
        [
            ", ".join(f"`{key}`" for key, variant in metric.variants.items() if variant != "detail"),
            metric.meaning.replace("|", "\\|"),
            metric.unit or "–",
            {True: "more", False: "less", None: "–"}[metric.higher],
        ]
        for metric in METRICS
    ]
    return _with_block(page, METRICS_BLOCK, markdown(["name", "definition", "unit", "better"], rows))


def _with_block(text: str, block: re.Pattern[str], table: str) -> str:
    text, count = block.subn(lambda _: table + "\n", text)
    if count != 1:
        raise ValueError(f"wanted one pair of comments around the table, got {count}")
    return text


def markdown(head: Sequence[str], rows: Cells) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def reconstruction(tables: Tables) -> str:
    """Table 1: surface distance of source shapes, and of their detail."""
    return _by_arm(tables, "table1", ("surface_distance", "surface_distance_detail"), ("", "detail"))


def held_out(tables: Tables) -> str:
    """Table 2: the same of held-out steps, and against parts that followed their own cuboids."""
    metrics = ("surface_distance", "surface_distance_own", "surface_distance_detail")
    return _by_arm(tables, "table2", metrics, ("", "own cuboids", "detail"))


def surfaces(tables: Tables) -> str:
    """A table of source shapes: signed normal consistency, the worst distance, connected components and handles."""

    def cells(figures: Mapping[str, Any]) -> list[str]:
        return [
            f"{figures['nc_signed']['mean']:.3f}",
            f"{figures['surface_distance']['max']:.2f}",
            f"{figures['same_components']['mean']:.2f}, {figures['same_genus']['mean']:.2f}",
        ]

    names = _categories(tables)
    titles = ("normals", "worst", "components, genus")
    head = ["", *(f"{name}: {titles[0]}" if i == 0 else titles[i] for name in names for i in range(len(titles)))]
    arms = [*in_order(tables["table1"][names[0]]), "cage"]
    rows = [[f"`{arm}`", *(cell for name in names for cell in cells(tables["table1"][name][arm]))] for arm in arms]
    return markdown(head, rows)


def chamfer(tables: Tables) -> str:
    """Squared Chamfer distance, the paper's metric, beside its figures."""
    names = _categories(tables)
    paper = {
        ("table1", "cagesdf_global"): [f"{PAPER_RECONSTRUCTION['CageSDF'][name]:g}" for name in names],
        ("table1", "deepsdf"): [f"{PAPER_RECONSTRUCTION['DeepSDF'][name]:g}" for name in names],
        ("table2", "cagesdf_global"): [f"{PAPER_HELD_OUT['CageSDF, with augmentation']:g} over all", "", ""],
        ("table2", "cagesdf_global_noaug"): [f"{PAPER_HELD_OUT['CageSDF, without augmentation']:g} over all", "", ""],
    }
    rows = []
    for table, title in (("table1", "source"), ("table2", "held-out")):
        for arm in [*in_order(tables[table][names[0]]), "ground_truth"]:
            label = "noise floor" if arm == "ground_truth" else f"`{arm}`"
            means = [f"{tables[table][name][arm]['cd_deepsdf']['mean']:.5f}" for name in names]
            rows.append([f"{title}: {label}", *means, *paper.get((table, arm), ["–"] * len(names))])
    return markdown(["", *names, *(f"paper: {name}" for name in names)], rows)


def gains(tables: Tables, kinds: Mapping[str, str]) -> str:
    """Median gains of kinds of trials, which have the title of a column each, by category; "" if there are none."""
    names = _categories(tables)
    edits = tables["edits"]["categories"]

    def gain(name: str, arm: str, kind: str) -> str:
        figures = edits[name].get(arm, {}).get(kind)
        return f"{figures['gain']['median']:.2f}".replace("-", "−") if figures else "–"

    of_first = edits[names[0]]
    arms = [arm for arm in [*in_order(of_first), "box_warp", "keep_warp"] if kinds.keys() & of_first.get(arm, {})]
    rows = [[f"`{arm}`", *(gain(name, arm, kind) for name in names for kind in kinds)] for arm in arms]
    first, *others = kinds.values()
    return markdown(["", *(title for name in names for title in (f"{name}: {first}", *others))], rows) if rows else ""


def generation(tables: Tables) -> str:
    """Table 3: FD and Cov of new shapes, and of an equal number of true ones."""
    names = _categories(tables)
    methods = {
        name: {(each["arm"], each["method"]): each for each in tables["table3"]["categories"][name]["methods"]}
        for name in names
    }
    label = {("real", "drawn"): "as many true shapes (the noise floor)"}
    rows = []
    for key in [key for key in methods[names[0]] if key[0] != "real" or key in label]:
        cells = [
            cell
            for name in names
            for cell in (
                [f"{methods[name][key]['fd']['mean']:.1f}", f"{methods[name][key]['cov']['mean']:.4f}"]
                if key in methods[name]
                else ["–", "–"]
            )
        ]
        rows.append([label.get(key, f"`{key[0]}`, {key[1]}"), *cells])
    return markdown(["", *(title for name in names for title in (f"{name}: FD", "Cov"))], rows)


def _by_arm(tables: Tables, table: str, metrics: Sequence[str], titles: Sequence[str]) -> str:
    names = _categories(tables)
    head = ["", *(f"{name}{': ' if title and i == 0 else ''}{title}" if i == 0 else title
                  for name in names for i, title in enumerate(titles))]  # fmt: skip
    arms = [*in_order(tables[table][names[0]]), "cage"]
    rows = [
        [f"`{arm}`", *(_spread(tables[table][name].get(arm), metric) for name in names for metric in metrics)]
        for arm in arms
    ]
    return markdown(head, rows)


def _spread(figures: Mapping[str, Any] | None, metric: str) -> str:
    """Mean ± standard deviation over shapes; a dash where nothing was measured."""
    if not figures or metric not in figures or figures[metric]["mean"] is None:
        return "–"
    return f"{figures[metric]['mean']:.2f} ± {figures[metric]['std']:.2f}"


def _categories(tables: Tables) -> list[str]:
    return sorted(tables["table1"])


def main() -> None:
    """Write the page, the README's table, and that of the metrics."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("tables", "page", "readme", "metrics"):
        parser.add_argument(name, type=Path)
    arguments = parser.parse_args()
    figures = json.loads(arguments.tables.read_text(encoding="utf-8"))
    _replace(arguments.page, lambda _: results_page(figures))
    _replace(arguments.readme, lambda text: with_readme_table(text, figures))
    _replace(arguments.metrics, with_metrics)


def _replace(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text(encoding="utf-8") if path.is_file() else ""), encoding="utf-8")


if __name__ == "__main__":
    main()
