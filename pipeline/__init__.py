"""The machinery of stages; knows nothing about shapes."""

from pipeline import artefact
from pipeline.executor import counter, device, draw, item_rng, parallel_groups, parallel_map, progress
from pipeline.params import (
    DeformParams,
    EditsParams,
    EvaluateParams,
    ExtractParams,
    FitParams,
    ImportParams,
    MatchParams,
    Params,
    ParamsError,
    ProgressParams,
    ReportParams,
    SampleParams,
    SynthesizeParams,
    TrainParams,
    TrainProgramsParams,
    TrialsParams,
    load,
)
from pipeline.stage import run_stage

__all__ = [
    "DeformParams",
    "EditsParams",
    "EvaluateParams",
    "ExtractParams",
    "FitParams",
    "ImportParams",
    "MatchParams",
    "Params",
    "ParamsError",
    "ProgressParams",
    "ReportParams",
    "SampleParams",
    "SynthesizeParams",
    "TrainParams",
    "TrainProgramsParams",
    "TrialsParams",
    "artefact",
    "counter",
    "device",
    "draw",
    "item_rng",
    "load",
    "parallel_groups",
    "parallel_map",
    "progress",
    "run_stage",
]
