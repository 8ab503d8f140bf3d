"""Recipes: everything a procedural shape is made from, as names and numbers."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from cagesdf.errors import InputError
from cagesdf.synthesis.layout import Draft, Drawing, Style, finish
from cagesdf.synthesis.programs import Assembled

Range = tuple[float, float]
Proportions = Mapping[str, float]


@dataclass(frozen=True)
class Recipe:
    """One shape: a family gives the structure, proportions its cage, kinds and factors its style."""

    shape_id: str  # <category>_<number>
    split: str  # "train" or "val"
    category: str
    family: str  # structure: same parts, labels and relations
    proportions: Mapping[str, float]  # of the cage, raw units or radians
    kinds: Mapping[str, str]  # choices of style
    factors: Mapping[str, float]  # numbers of style; lengths in raw units
    same_cage: str  # id of the shape that has the same proportions, or ""
    same_style: str  # id of the shape that has the same kinds and factors, or ""

    @property
    def style(self) -> Style:
        """Kinds and factors together."""
        return Style(self.kinds, self.factors)

    def to_json(self, **facts: object) -> str:
        """The recipe, and further facts about the file beside it, as indented JSON."""
        return json.dumps({**asdict(self), **facts}, indent=1, sort_keys=True) + "\n"

    @staticmethod
    def from_json(text: str) -> "Recipe":
        """Undo `to_json`, further facts left aside. Raises InputError if a field is missing."""
        content = json.loads(text)
        try:
            return Recipe(**{name: content[name] for name in Recipe.__dataclass_fields__})
        except (KeyError, TypeError) as error:
            raise InputError(f"recipe: field {error} is missing; wanted a recipe.json written by synthesize") from error


@dataclass(frozen=True)
class Family:
    """A structure, and the range that each of its proportions is drawn from."""

    draw: Callable[[Proportions], Draft]
    ranges: Mapping[str, Range]

    def typical(self) -> Drawing:
        """The shape in the middle of all ranges."""
        return finish(self.draw({name: (low + high) / 2 for name, (low, high) in self.ranges.items()}))


@dataclass(frozen=True)
class Category:
    """The families of a kind of thing, and the styles that all of them can have."""

    families: Mapping[str, Family]
    kinds: Mapping[str, tuple[str, ...]]
    factors: Mapping[str, Range]
    driven: tuple[str, str]  # the one factor that follows a proportion, and that proportion
    assemble: Callable[[Drawing, Drawing], Assembled] | None  # from a drawing and a typical one; None: no programs
