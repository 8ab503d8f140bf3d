"""Parts that come and go: added, duplicated, deleted, split.

What is left alone keeps cuboid, code and order. Cuboids no longer follow from a program then; the parts become
siblings, and relations between groups those between their parts.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.editing.links import Change, followed, link_of, linked, locked, part_relations
from cagesdf.editing.parts import free_name, part_names, select
from cagesdf.editing.script import Add, Delete, Duplicate, Split
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.structure.relations import Adjacency, Relation, Translation

MAX_PARTS = 200
SAME = 1e-9  # canonical: centres no further apart are one


def added(state: State, operation: Add) -> State:
    """The state with one more cuboid, along the user's axes. Raises InputError for more parts than MAX_PARTS."""
    # A cuboid's axes are named after the canonical ones, which the user's may have other names for.
    lengths = np.abs(state.similarity.rotation) @ np.array(operation.lengths) * state.similarity.scale
    centre = state.similarity.to_canonical(np.array([operation.centre]))[0]
    cuboid = Cuboid(centre, np.eye(3), lengths)
    like = most_like(state.cage, cuboid) if operation.like is None else select(state.structure, operation.like)[0]
    labels = state.structure.labels()
    part = free_name(operation.name, {*labels, *labels.values(), *part_names(state.structure).values()})
    if len(state.cage) == MAX_PARTS:
        raise InputError(f"it makes {MAX_PARTS + 1:,} parts; wanted at most {MAX_PARTS:,}")
    label_of = {name: labels[name] for name in state.cage.part_ids} | {part: operation.name}
    hierarchy = PartHierarchy.flat(tuple(label_of), tuple(label_of.values()), "")
    styles = state.part_styles.get(like)
    return replace(
        state,
        cage=Cage.of({**state.cage.cuboids(), part: cuboid}),
        structure=PartHierarchy(replace(hierarchy.tree, relations=part_relations(state))),
        part_styles={**state.part_styles, **({} if styles is None else {part: styles})},
        like={**state.like, part: state.seen_as(like)},
    )


def most_like(cage: Cage, cuboid: Cuboid) -> str:
    """The part whose lengths differ least from a cuboid's, by the sum of their squared logarithms."""
    return cage.part_ids[int(np.square(np.log(cage.size / cuboid.size)).sum(axis=1).argmin())]


def duplicated(state: State, operation: Duplicate) -> State:
    """The state with copies of some parts, moved; each repeats its original, and what related these relates them.

    Raises InputError for more parts than MAX_PARTS.
    """
    displacement = state.similarity.scale * (state.similarity.rotation @ np.array(operation.by))
    move: Change = lambda cuboid: replace(cuboid, centre=cuboid.centre + displacement)  # noqa: E731
    parts = select(state.structure, operation.part)
    moves = locked(state, dict.fromkeys(parts, move), followed(state, operation.mirror, operation.repeat))
    copies = _new_ids(state, moves)
    cuboids = {copies[part]: move(state.cage[part]) for part, move in moves.items()}
    relations = part_relations(state)
    between = [
        replace(relation, a=copies[relation.a], b=copies[relation.b])
        for relation in relations
        if relation.a in copies and relation.b in copies and _holds(relation, state, copies, cuboids)
    ]
    offsets = {part: (cuboids[copy].centre - state.cage[part].centre) / state.stretch for part, copy in copies.items()}
    to_originals = [Translation(part, copies[part], (x, y, z)) for part, (x, y, z) in _numbers(offsets).items()]
    return _with_parts(state, copies, state.cage.cuboids() | cuboids, (*relations, *between, *to_originals))


def deleted(state: State, operation: Delete) -> State:
    """The state without some parts; their relations go with them. Raises InputError if none would be left."""
    parts = linked(select(state.structure, operation.part), followed(state, operation.mirror, operation.repeat))
    cuboids = {part: cuboid for part, cuboid in state.cage.cuboids().items() if part not in parts}
    if not cuboids:
        raise InputError("it leaves no part; wanted at least one")
    relations = [each for each in part_relations(state) if each.a in cuboids and each.b in cuboids]
    return _with_parts(state, {}, cuboids, relations)


def split(state: State, operation: Split) -> State:
    """The state with some parts in two, which touch; what related a part to others that are cut relates both ends.

    Raises InputError for more parts than MAX_PARTS.
    """
    row, sign = state.own_axis(operation.axis)
    parts = select(state.structure, operation.part)
    links = followed(state, operation.mirror, operation.repeat)
    low, high = (
        locked(state, dict.fromkeys(parts, _cut(row, start, end) if sign > 0 else _cut(row, 1 - end, 1 - start)), links)
        for start, end in ((0.0, operation.at), (operation.at, 1.0))
    )
    ends = _new_ids(state, low)
    cuboids = {part: low[part](cuboid) if part in low else cuboid for part, cuboid in state.cage.cuboids().items()}
    cuboids |= {ends[part]: change(state.cage[part]) for part, change in high.items()}
    relations = list[Relation]()
    for relation in part_relations(state):
        cut = (relation.a in ends) + (relation.b in ends)
        # One that is cut is no image of one that isn't, though both may go on touching.
        if cut == 0 or isinstance(relation, Adjacency):
            relations.append(relation)
        elif cut == 2:
            relations += [relation, replace(relation, a=ends[relation.a], b=ends[relation.b])]
    relations += [Adjacency(part, end, 0.0) for part, end in ends.items()]
    return _with_parts(state, ends, cuboids, relations)


def _cut(row: int, start: float, end: float) -> Change:
    """A change that leaves of a cuboid the share from `start` to `end` along one of its axes."""
    factors = np.ones(3)
    factors[row] = end - start
    shift = (start + end - 1) / 2
    return lambda cuboid: Cuboid(
        cuboid.centre + shift * cuboid.size[row] * cuboid.axes[row], cuboid.axes, cuboid.size * factors
    )


def _new_ids(state: State, parts: Iterable[str]) -> dict[str, str]:
    """By part, an id for one that is like it; no id, label or name that there is, so that none of these changes."""
    taken = {*state.cage.part_ids, *state.structure.labels().values(), *part_names(state.structure).values()}
    new_ids = {}
    for part in parts:
        new_ids[part] = free_name(part, taken)
        taken.add(new_ids[part])
    if (count := len(state.cage) + len(new_ids)) > MAX_PARTS:
        raise InputError(f"it makes {count:,} parts; wanted at most {MAX_PARTS:,}")
    return new_ids


def _holds(relation: Relation, state: State, copies: Mapping[str, str], cuboids: Mapping[str, Cuboid]) -> bool:
    """Whether what a relation says of two parts' centres is true of their copies', too."""
    link = link_of(relation, state)
    if link is None:
        return True
    a, b = cuboids[copies[relation.a]].centre, cuboids[copies[relation.b]].centre
    difference = link(state.cage[relation.a].centre) - state.cage[relation.b].centre
    return bool(np.abs(link(a) - b - difference).max() <= SAME)


def _numbers(vectors: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
    return {part: vector.tolist() for part, vector in vectors.items()}


def _with_parts(
    state: State, new: Mapping[str, str], cuboids: Mapping[str, Cuboid], relations: Iterable[Relation]
) -> State:
    """The state around these cuboids; `new` are ids of new parts by those whose label and code they have."""
    labels = state.structure.labels()
    originals = {part: part for part in state.cage.part_ids} | {copy: part for part, copy in new.items()}
    hierarchy = PartHierarchy.flat(tuple(cuboids), tuple(labels[originals[part]] for part in cuboids), "")
    return replace(
        state,
        cage=Cage.of(cuboids),
        structure=PartHierarchy(replace(hierarchy.tree, relations=tuple(relations))),
        part_styles={
            part: state.part_styles[originals[part]] for part in cuboids if originals[part] in state.part_styles
        },
        kept={
            part: state.kept[original] * cuboid.size / state.cage[original].size
            for part, cuboid in cuboids.items()
            if (original := originals[part]) in state.kept
        },
        like={part: seen for part in cuboids if (seen := state.seen_as(originals[part])) != part},
    )
