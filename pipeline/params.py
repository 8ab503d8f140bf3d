"""The schema of `params.yaml`: one frozen model a stage.

The schema has no defaults: every value stands in the file, because `pipeline/` is not among
the stages' `deps` and a default changed here would leave stale results. Values that change no
result (workers, device) are not parameters; `executor.py` takes them from the environment.

A stage that reads a folder for each category or arm has the names in its parameters: they are those under `run`, which
alone has them in the file, and `dvc.yaml` lists them among the stage's `params`.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.decoders import decoder_sizes
from pipeline.errors import PipelineError

Count = Annotated[int, Field(ge=1)]
Natural = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, Field(pattern=r"^\w[\w.-]*$")]  # of a folder
Names = Annotated[tuple[Name, ...], Field(min_length=1)]


# Numbers that a decoder alone has, by their type as it is written there.
OWN: dict[str, Callable[[Any], bool]] = {
    "int": lambda value: type(value) is int and value >= 1,
    "float": lambda value: type(value) in (int, float) and math.isfinite(value),
}
WANTED = {"int": "a whole number of at least 1", "float": "a finite number"}


class ParamsError(PipelineError):
    """Parameters that are missing, unknown or of the wrong type; the message names all of them."""


class Params(BaseModel):
    """Parameters that every stage has."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)

    format: Count  # of all artefacts; a change of pipeline/ that alters bytes raises it


class SynthesizeParams(Params):
    """How many procedural shapes, and how broken."""

    train: Count  # training shapes a category
    val: Natural  # validation shapes a category
    defective: Share  # of the parts written with a defect: opened, flipped or doubled faces
    seed: Natural


class ImportParams(Params):
    """How foreign files are read and repaired."""

    include: str  # glob over shape names; "*" takes all
    up: Literal["y", "z"]  # up axis of the files
    parts: Literal["given", "found", "auto"]  # by files, in the surface, or there where a file's groups are no parts
    weld: Positive  # vertices nearer than this are one, canonical units
    max_faces: Count  # a shape
    max_parts: Count  # a shape
    min_thickness: Positive  # a thinner part is a sheet and gets a plate; above 0.001, sheets are rejected; canonical
    max_rejected: Share  # of the shapes; more stops the stage


class FitParams(Params):
    """Cuboids that bound the parts."""

    slack: NonNegative  # boxes within (1 + slack) of the minimum volume compete for the axes nearest the canonical
    min_size: Positive  # thinner cuboids are made this thick, canonical units
    margin: NonNegative  # how far a part may stick out of a cuboid of its own, canonical units
    points: Count  # on each part's surface, that a program is fitted to
    max_rejected: Share
    seed: Natural


class MatchParams(Params):
    """Who is deformed towards whom."""

    unmatched: Literal["drop", "scale"]  # a shape without a partner
    scale: tuple[Positive, Positive]  # range of the factors where `unmatched` is scale
    max_rejected: Share
    seed: Natural


class DeformParams(Params):
    """The steps of a sequence."""

    steps: Count  # of a sequence, the rest shape among them
    held_out: tuple[Natural, ...]  # steps kept from training
    interpolation: Literal["cuboids", "program"]  # of what, where a shape has a program
    transfer: Literal["trilinear", "keep_details"]  # of surfaces: details stretch with their cuboid, or keep their size
    max_rejected: Share


class TrainProgramsParams(Params):
    """The programs' autoencoder, and how it is tried. Categories without programs use `samples` and what follows."""

    width: Count  # of its layers
    code: Count  # numbers in a program's code
    steps: Count  # optimiser steps
    batch: Count  # programs a step
    learning_rate: Positive  # falls to zero along a cosine
    divergence: NonNegative  # weight of the codes' divergence from the normal distribution
    hidden: Share  # of the lines, that the decoder isn't shown in training
    samples: Count  # drawn for the summary
    temperature: NonNegative  # of those; 1 draws as it was trained
    max_rejected: Share
    seed: Natural


class SampleParams(Params):
    """Points of one deformed shape, and the shards they go to."""

    near: Count  # importance sampled
    uniform: Natural  # in the whole cube
    per_cuboid: Natural  # points in each cuboid, at least
    beta: Positive  # importance weight is exp(-beta |sdf|)
    part_near: Positive  # around a part's surface, for each unit of its area where its cuboid has length 1 (a box: 6)
    part_uniform: Positive  # in a part's cuboid, the same
    shards: Count  # files
    max_rejected: Share
    seed: Natural


class TrainParams(Params):
    """One arm: network, data and schedule; and numbers that its decoder alone is made with."""

    model_config = ConfigDict(extra="allow")

    decoder: str  # of those in cagesdf/models/arms.py
    latents: Literal["source", "deformed"]  # one latent a source shape, or one a deformed shape
    steps_of: Literal["all", "rest"]  # training steps of the sequences, or source shapes only
    reach: NonNegative  # CageDecoder: of its cuboid, of the points that count; canonical units
    width: Count  # hidden units a layer
    layers: Count  # hidden layers
    latent_dim: Count
    mapping: tuple[Count, ...]  # hidden widths of the mapping network
    octaves: Natural  # sine features of each coordinate the backbone is given
    code_dim: Count  # TriplaneDecoder: numbers of a part's code
    cells: Count  # of its planes, along each axis
    channels: Count  # numbers in each of those cells
    line_cells: Count  # of its lines
    line_channels: Count  # numbers in each of those cells
    context: Count  # width of its transformer
    context_layers: Count
    heads: Count
    clamp: NonNegative  # of distances in the loss, in the decoder's unit; 0: none, as OccupancyDecoder must have it
    latent_weight: NonNegative  # λ
    latent_std: Positive  # of the initial codes' norm
    steps: Count  # optimiser steps
    batch_chunks: Count  # groups a step
    bundle: Count  # of them, those that share a deformed shape
    learning_rate: Positive
    latent_learning_rate: Positive
    code_learning_rate: Positive  # TriplaneDecoder: of the parts' codes while those come first
    codes_first: Share  # share of the steps in which they do, and the transformer learns them
    schedule: Literal["cosine", "halve"]  # to zero, or halved every `halve_every` steps
    halve_every: Count
    precision: Literal["auto", "float32", "bfloat16"]  # of the matrix products; auto: as the processor has it
    checkpoint_every: Count  # steps
    log_every: Count  # steps
    snapshots: tuple[Count, ...]  # steps after which the weights are kept too, for evaluate_progress
    seed: Natural


class ExtractParams(Params):
    """Which surfaces, how fine."""

    resolution: Count  # cells along [-1.05, 1.05]
    sources: Count  # number of source shapes, at most, drawn by seed (Table 1)
    held_out: Count  # number of shapes, at most, whose held-out steps are extracted (Table 2)
    loose: Literal["keep", "drop"]  # pieces that don't hang together with the largest
    seed: Natural


class EvaluateParams(Params):
    """How surfaces are measured."""

    points: Count  # on each surface, for each seed
    detail: Positive  # true surface further than this share of the longest side from the cage counts as detail
    seeds: tuple[Natural, ...]  # figures are averaged over these
    arms: Names  # run's


class ProgressParams(Params):
    """How surfaces are measured along a training."""

    resolution: Count  # cells along [-1.05, 1.05]
    shapes: Count  # of each arm
    points: Count  # on each surface
    detail: Positive  # as evaluate's
    seed: Natural
    arms: Names  # run's


class TrialsParams(Params):
    """Edits whose true outcome is known, and how surfaces are measured on them."""

    swaps: Natural  # of cuboids and styles, a category; at most as many as no training step has shown
    mixes: Natural  # of these, some in which the parts of one label alone take the style
    shapes: Natural  # number of shapes, at most, whose other edits are tried
    local: Natural  # edits of single cuboids, a shape
    resize: tuple[Positive, Positive]  # range of the factor of one side of a cuboid
    move: tuple[Positive, Positive]  # range of its way along one of its axes, canonical units
    beyond: tuple[float, ...]  # places on a sequence's line; its own are in [0, 1]
    blend: Positive  # how far from a cuboid it moves shared vertices, canonical units
    points: Count  # on each surface
    detail: Positive  # as evaluate's
    seed: Natural


class EditsParams(Params):
    """How an arm's surfaces are extracted for trials; all but `resolution` as extract_meshes'."""

    resolution: Count  # cells along [-1.05, 1.05]
    loose: Literal["keep", "drop"]
    arms: Names  # run's


class GenerateParams(Params):
    """New shapes of an arm; `loose` as extract_meshes'."""

    shapes: Count  # by each of its methods
    temperature: NonNegative  # of cages and codes; 1 draws them as they were spread in training
    tau: Positive | Literal["likelihood"]  # temperature of the weights of similar cages' codes, canonical units
    resolution: Count  # cells along [-1.05, 1.05]
    loose: Literal["keep", "drop"]
    points: Count  # on each surface
    stability: Literal["support", "simulation"]  # how it is tested; the second needs the extra `physics`
    seed: Natural


class CloudsParams(Params):
    """Shapes that generated ones are compared with, as points."""

    drawn: Natural  # references a category beside the validation shapes, where there are recipes
    points: Count  # a shape
    seed: Natural  # another than synthesize's


class FeaturesParams(Params):
    """The classifier whose features generated shapes are compared in."""

    weights: str  # a file as this stage writes it, trained elsewhere; "" trains here
    train: Count  # shapes a category
    val: Count  # further shapes a category, of which those recognised are counted
    points: Count  # a shape
    widths: tuple[Count, ...]  # of the points' layers; the last is the number of features
    hidden: Count  # units of the classifier
    steps: Count  # optimiser steps
    batch: Count  # shapes a step
    batch_points: Count  # of each of them
    learning_rate: Positive
    seed: Natural


class GenerationParams(Params):
    """How generated shapes are compared with references."""

    points: Count  # of each cloud, for Chamfer distances; features have all that the classifier takes
    draws: Count  # of as many references as there are generated shapes, at most
    seed: Natural
    generators: Names  # run's


class ReportParams(Params):
    """Contents of the page."""

    shapes: Count  # a category, in the comparison picture
    generated: Count  # of each method
    image_size: Count  # pixels along each side of one cell
    categories: Names  # run's
    arms: Names  # run's
    generators: Names  # run's


SECTIONS: dict[str, type[Params]] = {
    "synthesize": SynthesizeParams,
    "import_shapes": ImportParams,
    "fit_cuboids": FitParams,
    "match_targets": MatchParams,
    "deform_sequences": DeformParams,
    "train_programs": TrainProgramsParams,
    "sample_points": SampleParams,
    "train": TrainParams,
    "extract_meshes": ExtractParams,
    "evaluate": EvaluateParams,
    "evaluate_progress": ProgressParams,
    "make_trials": TrialsParams,
    "evaluate_edits": EditsParams,
    "generate": GenerateParams,
    "make_clouds": CloudsParams,
    "train_features": FeaturesParams,
    "evaluate_generation": GenerationParams,
    "report": ReportParams,
}


LISTS = ("categories", "arms", "generators")  # of run, that stages' parameters hold


class RunParams(BaseModel):
    """Lists that the DVC graph is multiplied by."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    categories: Names
    arms: Names
    generators: Names  # those of the arms that new shapes are made with


def read_yaml(content: bytes, source: str) -> dict[str, Any]:
    """A YAML file's mapping of sections; UTF-8 or UTF-16, an empty file is an empty one.

    Raises ParamsError in one line with the file's name `source` and, where YAML breaks, line and column.
    """
    try:
        mapping = yaml.safe_load(content)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ParamsError(f"{source}{place}: is not YAML ({error.problem or error.context})") from error
    except yaml.reader.ReaderError as error:
        before = content[: error.position]
        place = f"line {before.count(10) + 1}, column {len(before) - before.rfind(10)}"
        raise ParamsError(f"{source}, {place}: is not YAML ({error.reason})") from error
    # A value that isn't of its tag's kind, such as the date 2024-13-01, and brackets nested too deeply.
    except (ValueError, LookupError, AttributeError, RecursionError) as error:
        raise ParamsError(f"{source}: is not YAML ({error})") from error
    if mapping is not None and not isinstance(mapping, dict):
        raise ParamsError(f"{source}: wanted a mapping of sections, got {type(mapping).__name__}")
    return mapping or {}


def load(section: str, path: Path = Path("params.yaml")) -> Any:
    """The parameters of one section: a stage's name, or `arms.<name>`.

    The whole file is checked first. Raises ParamsError that names every missing, unknown or
    ill-typed entry by its path, and every unreadable file.
    """
    sections = check(path)
    if section not in sections:
        raise ParamsError(f"{path}: has no section {section!r}; there are {', '.join(sections)}")
    return sections[section]


def check(path: Path) -> dict[str, Params]:
    """All sections of a parameter file, arms merged with `train`. Raises ParamsError as `load` does."""
    try:
        content = read_yaml(path.read_bytes(), str(path))
    except OSError as error:
        raise ParamsError(f"{path}: can't be read ({error.strerror}); run in a folder with a params.yaml") from error
    problems: list[str] = []
    sections: dict[str, Params] = {}

    def validate(place: str, model: type[BaseModel], values: Any) -> Any:
        try:
            return model.model_validate(values)
        except ValidationError as error:
            for item in error.errors():
                name = ".".join([place, *map(str, item["loc"])])
                got = "" if item["type"] == "missing" else f", got {item['input']!r}"
                problems.append(f"{name}: {item['msg'].lower()}{got}")
            return None

    known = {*SECTIONS, "arms", "run", "format"}
    problems += [
        f"{name}: unknown section; there are {', '.join(sorted(known))}" for name in content if name not in known
    ]
    problems += [f"{name}: section missing" for name in sorted(known) if name not in content]
    if problems:
        raise ParamsError(f"{path}: " + "; ".join(problems))
    run = validate("run", RunParams, content["run"] or {})
    named = run.model_dump() if run else dict.fromkeys(LISTS, ("unknown",))
    for name, model in SECTIONS.items():
        values = content[name]
        if isinstance(values, dict):
            lists = {key: names for key, names in named.items() if key in model.model_fields}
            problems += [f"{name}.{key}: stands under run" for key in lists if key in values]
            values = {"format": content["format"], **values, **lists}
        sections[name] = validate(name, model, values)
        problems += wrong_sizes(name, sections[name])
    arms = content["arms"] if isinstance(content["arms"], dict) and isinstance(content["train"], dict) else {}
    if not isinstance(content["arms"], dict):
        problems.append(f"arms: wanted a mapping, got {content['arms']!r}")
    for name, differences in arms.items():
        if not isinstance(differences or {}, dict):
            problems.append(f"arms.{name}: wanted a mapping of differences from train, got {differences!r}")
            continue
        merged = {"format": content["format"], **content["train"], **(differences or {})}
        before = len(problems)
        sections[f"arms.{name}"] = validate(f"arms.{name}", TrainParams, merged)
        problems += wrong_sizes(f"arms.{name}", sections[f"arms.{name}"])
        # Problems of train are reported once.
        reported = {
            problem.split(":")[0].split(".", 1)[1] for problem in problems[:before] if problem.startswith("train.")
        }
        problems[before:] = [p for p in problems[before:] if p.split(":")[0].split(".", 2)[2] not in reported]
    if run is not None:
        problems += [f"run.arms: no arm {name!r} under arms" for name in run.arms if name not in arms]
        problems += [f"run.generators: no arm {name!r} in run.arms" for name in run.generators if name not in run.arms]
        problems += [f"run.{key}: names one twice" for key, names in named.items() if len({*names}) < len(names)]
    problems = problems or list(contradictions(sections))
    if problems:
        raise ParamsError(f"{path}: " + "; ".join(problems))
    return sections


def wrong_sizes(place: str, params: Any) -> Iterator[str]:
    """Problems of an arm's decoder, and of the numbers that this decoder alone has."""
    if not isinstance(params, TrainParams):
        return
    decoders, extra = decoder_sizes(), params.model_extra or {}
    if params.decoder not in decoders:
        yield f"{place}.decoder: no decoder {params.decoder!r}; there are {', '.join(decoders)}"
        return
    sizes = decoders[params.decoder]
    for name, value in extra.items():
        if name not in sizes:
            yield f"{place}.{name}: extra inputs are not permitted, got {value!r}"
        elif sizes[name] not in OWN:
            yield f"{place}.{name}: {params.decoder} has it as {sizes[name]}; wanted {' or '.join(OWN)}, or a constant"
        elif not OWN[sizes[name]](value):
            yield f"{place}.{name}: wanted {WANTED[sizes[name]]}, got {value!r}"
    for name in sizes:
        if name not in extra and name not in TrainParams.model_fields:
            yield f"{place}.{name}: field required; {params.decoder} is made with it"


def contradictions(sections: dict[str, Any]) -> Iterator[str]:
    """Contradictions between sections that are each right, which stages would report hours later or never."""
    deform, features, clouds = (sections[name] for name in ("deform_sequences", "train_features", "make_clouds"))
    if not {*deform.held_out} <= {*range(1, deform.steps)}:
        yield f"deform_sequences.held_out: got {deform.held_out}, wanted steps among 1 to {deform.steps - 1}"
    for name in ("make_clouds", "generate"):
        got = sections[name].points
        for needed, wanted in (
            ("train_features", 0 if features.weights else features.points),  # weights bring a number of their own
            ("evaluate_generation", sections["evaluate_generation"].points),
        ):
            if got < wanted:
                yield f"{name}.points: got {got}, wanted at least {needed}.points, {wanted}"
    if clouds.seed == sections["synthesize"].seed:
        yield f"make_clouds.seed: got {clouds.seed}, wanted another than synthesize.seed: references must be new shapes"
