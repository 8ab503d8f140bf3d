"""What `params.yaml` is checked against is read off the decoders without importing them."""

import re
from pathlib import Path

import pytest

from cagesdf.models.arms import DECODERS, sizes_of_decoder
from pipeline import decoders, params
from pipeline.decoders import decoder_sizes

ARMS = """
DECODERS: dict[str, type] = {decoder.__name__: decoder for decoder in (Toy,)}
"""
TOY = """
class Toy:
    def __init__(self, latent_dim: int, balls: int, spread: float, places: Sequence[int], mystery) -> None: ...
"""


def test_names_and_types_are_those_that_the_classes_have() -> None:
    assert [*decoder_sizes()] == [*DECODERS]
    for name, sizes in decoder_sizes().items():
        types = sizes_of_decoder(name)
        assert [*sizes] == [*types]
        assert {size for size, kind in types.items() if kind is int} == {size for size in sizes if sizes[size] == "int"}


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"balls": 0}, "balls: wanted a whole number of at least 1, got 0"),
        ({"balls": True}, "balls: wanted a whole number of at least 1, got True"),
        ({"spread": float("inf")}, "spread: wanted a finite number, got inf"),
        ({"places": [1]}, r"places: Toy has it as Sequence\[int\]; wanted int or float, or a constant"),
        ({"mystery": 1}, "mystery: Toy has it as an argument without a type; wanted int or float"),
        ({"unheard_of": 1}, "unheard_of: extra inputs are not permitted"),
    ],
)
def test_numbers_of_a_decoder_s_own_are_checked_by_their_types(
    own: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = params.load("arms.cagesdf", Path(params.__file__).parents[1] / "params.yaml")
    (tmp_path / "arms.py").write_text(ARMS)
    (tmp_path / "toy.py").write_text(TOY)
    monkeypatch.setattr(decoders, "MODELS", tmp_path)
    monkeypatch.setattr(params, "decoder_sizes", decoder_sizes.__wrapped__)
    values = {"balls": 1, "spread": 0.5, "places": None, "mystery": None} | own
    given = {name: value for name, value in values.items() if value is not None}
    arm = known.model_copy(update={"decoder": "Toy"})
    object.__setattr__(arm, "__pydantic_extra__", given)
    assert any(re.search(message, problem) for problem in params.wrong_sizes("arms.toy", arm))
