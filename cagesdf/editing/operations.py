"""The operations of a script: functions from state to state."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.deformation.sequences import scaled_cage
from cagesdf.editing.attachments import attached
from cagesdf.editing.links import Change, alike, followed, linked, locked
from cagesdf.editing.members import added, deleted, duplicated, split
from cagesdf.editing.parts import part_names, select, with_parameter
from cagesdf.editing.script import (
    Add,
    Blend,
    Build,
    Delete,
    Details,
    Duplicate,
    Harmonise,
    Mix,
    Move,
    Operation,
    Redo,
    Resize,
    Rotate,
    Scale,
    Script,
    Set,
    Split,
    Step,
    Style,
    Swap,
    Undo,
)
from cagesdf.editing.state import History, PartStyle, State
from cagesdf.editing.styles import Styles, corresponding
from cagesdf.errors import InputError
from cagesdf.frames import Similarity
from cagesdf.structure.executor import execute
from cagesdf.structure.stored import read_structure

REACH = 2.0  # canonical: as far from the origin as a corner may be; the shape at rest reaches 1
MAX_RELATION = 1e6  # of the numbers of a relation: planes, ways, pivots, angles
SMALLEST = 1e-3  # canonical: the least length of a cuboid
FARTHEST = 1e10  # radii from the user's origin, within what exports hold
LARGEST = 1e25  # user's units that a radius may have; as small it may be
ENDS = {"low": 0.5, "centre": 0.0, "high": -0.5}  # by what stays: how far the centre goes, as a share of the growth


def edited(state: State, script: Script, styles: Styles) -> History:
    """The history that a script leads to.

    Raises InputError that names the operation's place in the script: for parts, parameters and styles that
    there are not, and cuboids thinner than SMALLEST or farther than REACH.
    """
    history = History.of(state)
    for i, operation in enumerate(script):
        try:
            history = apply(history, operation, styles)
        except InputError as error:
            raise InputError(f"script: operation {i}: {operation.op}: {error}") from error
    return history


def apply(history: History, operation: Operation, styles: Styles) -> History:
    """The history after one more operation. Raises InputError as `edited` does."""
    match operation:
        case Undo():
            return history.undone()
        case Redo():
            return history.redone()
        case _:
            # An overflow is refused by the checks of the result.
            with np.errstate(over="ignore", invalid="ignore"):
                return history.then(_after(history.present, operation, styles))


def _after(state: State, operation: Step, styles: Styles) -> State:
    match operation:
        case Move() | Resize() | Rotate():
            return _sound(_with_details(state, _change_parts(state, operation), operation.details))
        case Add():
            return _sound(added(state, operation))
        case Duplicate():
            return _sound(duplicated(state, operation))
        case Delete():
            return deleted(state, operation)
        case Split():
            return _sound(split(state, operation))
        case Scale(factors=factors, details=details):
            return _sound(_with_details(state, scaled(state, factors), details))
        case Set(parameter=parameter, value=value, details=details):
            return _sound(_with_details(state, reprogrammed(state, parameter, value), details))
        case Swap(style_of=shape_id):
            return replace(state, latent=styles.named(shape_id).latent, residuals={})
        case Blend(style_of=shape_id, weight=weight):
            return blended(state, styles.named(shape_id).latent, np.float32(weight))
        case Mix():
            return _sound_details(mixed(state, operation, styles))
        case Style():
            return styled(state, operation, styles)
        case Build(structure=text, frame=numbers):
            return _sound(built(state, text, numbers))
        case Harmonise():
            residuals = {
                part: residual
                for part in state.cage.part_ids
                if (residual := state.residuals.get(state.seen_as(part))) is not None
            }
            kept = {part: lengths for part, lengths in state.kept.items() if part in state.part_styles}
            return replace(state, seen=state.cage, like={}, kept=kept, residuals=residuals)


def styled(state: State, operation: Style, styles: Styles) -> State:
    """A latent and residuals by their numbers. Raises InputError where these are too many or too few."""
    if len(operation.code) != len(state.latent):
        raise InputError(f"code: {len(operation.code)} numbers; this run's codes have {len(state.latent)}")
    wanted = styles.code_dim or len(state.latent)
    residuals = {}
    for pattern, numbers in (operation.residuals or {}).items():
        if len(numbers) != wanted:
            raise InputError(f"residuals: {pattern}: {len(numbers)} numbers; wanted {wanted}, as its parts' codes have")
        for part in select(state.structure, pattern):
            residuals[state.seen_as(part)] = np.array(numbers, np.float32)
    restyled = replace(state, latent=np.array(operation.code, np.float32), residuals=residuals)
    return restyled if operation.parts is None else _styled_parts(restyled, operation.parts, styles)


def _styled_parts(state: State, codes: Mapping[str, Sequence[float]], styles: Styles) -> State:
    """Parts with the style of other latents, all others with the state's own."""
    if codes and not styles.by_part:
        raise InputError("parts: this arm has one style for the whole shape")
    part_styles = dict[str, tuple[PartStyle, ...]]()
    for pattern, numbers in codes.items():
        if len(numbers) != len(state.latent):
            raise InputError(f"parts: {pattern}: {len(numbers)} numbers; this run's codes have {len(state.latent)}")
        latent = np.array(numbers, np.float32)
        part_styles |= {part: (PartStyle(latent, None, part, 1.0),) for part in select(state.structure, pattern)}
    return replace(state, part_styles=part_styles)


def blended(state: State, latent: Float32[ndarray, " d"], weight: np.float32) -> State:
    """A state on its way to another latent; at weight 1 nothing of its own residuals is left."""
    residuals = {part: (1 - weight) * residual for part, residual in state.residuals.items()} if weight < 1 else {}
    return replace(state, latent=(1 - weight) * state.latent + weight * latent, residuals=residuals)


def mixed(state: State, operation: Mix, styles: Styles) -> State:
    """Some parts with codes of another shape's corresponding parts, or on the way there.

    A part that none corresponds to gets the code that the network has for the other shape's latent in this cage. Parts
    keep what was mixed into them when the latent changes. Raises InputError for a run whose parts have no codes.
    """
    if not styles.by_part:
        raise InputError(
            "this arm has one style for the whole shape; take one whose parts have codes, such as cagesdf, or blend"
        )
    other = styles.named(operation.style_of)
    parts = linked(select(state.structure, operation.part), followed(state, operation.mirror, operation.repeat))
    partners = corresponding(state, other, operation.source)
    part_styles, weight = dict(state.part_styles), operation.weight
    lengths = dict(zip(state.cage.part_ids, state.evaluated().size))
    unit = state.similarity.scale / other.similarity.scale  # canonical here, of the other shape's canonical unit
    for part in parts:
        cage = other.cage if part in partners else None
        step = PartStyle(other.latent, cage, partners.get(part, part), weight)
        # A step of weight 1 replaces all earlier ones.
        before = part_styles.get(part, ()) if weight < 1 else ()
        part_styles[part] = (*before, step)
        source_size = state.cage[part].size
        if operation.details == "keep":
            source_size = state.seen[state.seen_as(part)].size if cage is None else unit * cage[step.part].size
        lengths[part] = (1 - weight) * lengths[part] + weight * source_size
    return replace(state, part_styles=part_styles).evaluated_in(lengths)


def _with_details(before: State, after: State, details: Details) -> State:
    """The state `after`, with details of resized parts that stretch from what they are `before`, or keep their size."""
    lengths = before.evaluated().size
    if details == "stretch":
        lengths = np.where(lengths == before.cage.size, after.cage.size, lengths * after.cage.size / before.cage.size)
    return after.evaluated_in(dict(zip(after.cage.part_ids, lengths)))


def scaled(state: State, factors: tuple[float, float, float]) -> State:
    """The whole cage stretched along the user's axes about the canonical origin."""
    along = np.ones(3)
    for axis, factor in zip("xyz", factors):
        along[state.own_axis(axis)[0]] = factor
    return replace(state, cage=scaled_cage(state.cage, along), stretch=state.stretch * along)


def built(state: State, text: str, frame: tuple[float, ...] | None) -> State:
    """Another structure and its own cuboids, in the user's frame that `frame` gives as `Similarity.to_numbers` does.

    Without it, it is the canonical one. Raises InputError if `text` is no structure as `Structure.to_json` writes it,
    or one without cuboids, and if `frame` is no similarity.
    """
    structure = read_structure(text)
    similarity = Similarity(1.0, np.eye(3), np.zeros(3)) if frame is None else Similarity.from_numbers([*frame])
    if similarity.scale <= 0 or not _proper(similarity.rotation[None]).all():
        raise InputError("frame is no similarity; wanted a scale > 0, a proper rotation by rows, a translation")
    reach = np.abs(similarity.translation).max()
    if not (1 / LARGEST <= similarity.scale <= LARGEST and reach <= FARTHEST):
        raise InputError(
            f"frame has scale {similarity.scale:.3g} and places the shape {reach:.3g} radii from the origin; wanted a "
            f"scale from {1 / LARGEST:g} to {LARGEST:g}, and at most {FARTHEST:g} radii"
        )
    cage = structure.cage()
    if not (proper := _proper(cage.axes)).all():
        part = cage.part_ids[int(proper.argmin())]
        raise InputError(f"structure: the axes of {part!r} are no rotation; wanted two directions across each other")
    for relation in structure.relations():
        numbers = np.hstack([value for name, value in vars(relation).items() if name not in ("a", "b")])
        if not np.abs(numbers).max() <= MAX_RELATION:
            ends = f"{relation.a!r} and {relation.b!r}"
            raise InputError(
                f"structure: {ends} are related by numbers beyond {MAX_RELATION:g}; wanted canonical lengths"
            )
    return State.opened(cage, structure, state.latent, similarity)


def _proper(matrices: Float[ndarray, "n 3 3"]) -> Bool[ndarray, " n"]:
    """Which of them are rotations: rows of length 1, across each other, right-handed."""
    apart = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    return (apart <= 1e-6) & (np.linalg.det(matrices) > 0)


def reprogrammed(state: State, name: str, value: float) -> State:
    """Another value of one of the program's parameters; the cuboids move as the program's do.

    What was done to a cuboid by hand stays: it is turned, moved and stretched by as much as the program's
    own. Raises InputError as `parts.with_parameter` does, and where there is no program or a cuboid vanishes.
    """
    placed = state.structure.placed_program()
    if placed is None:
        raise InputError("the shape has no program: its cuboids are free of each other; move and resize them")
    program, placement = placed
    changed = with_parameter(program, name, value)
    before, after = (
        scaled_cage(execute(version).transformed(placement), state.stretch) for version in (program, changed)
    )
    if (after.size <= 0).any():
        raise InputError(f"parameter {name!r}: with {value:g} a cuboid has no volume")
    return replace(state, cage=_followed(state.cage, before, after), structure=state.structure.with_program(changed))


def _followed(cage: Cage, before: Cage, after: Cage) -> Cage:
    """The cage moved as another one was; cuboids that stayed there stay, to the last bit, so that nothing is redone."""
    same = (before.vectors() == after.vectors()).all(axis=1)
    turns = before.axes.swapaxes(1, 2) @ after.axes
    return Cage(
        cage.part_ids,
        np.where(same[:, None], cage.centre, cage.centre + (after.centre - before.centre)),
        np.where(same[:, None, None], cage.axes, cage.axes @ turns),
        np.where(same[:, None], cage.size, cage.size * (after.size / before.size)),
    )


def _change_parts(state: State, operation: Move | Resize | Rotate) -> State:
    parts = select(state.structure, operation.part)
    match operation:
        case Move(by=by, frame="shape"):
            displacement = state.similarity.scale * (state.similarity.rotation @ np.array(by))
            change: Change = lambda cuboid: replace(cuboid, centre=cuboid.centre + displacement)  # noqa: E731
        case Move(by=by):
            change = _moved_in_own_frame(state, by)
        case Resize(frame="shape"):
            change = _stretched_together(state, parts, operation)
        case Resize():
            change = _stretched(state, operation)
        case Rotate(frame="shape"):
            change = _turned_together(state, parts, operation)
        case Rotate():
            change = _turned(state, operation)
    links = followed(state, operation.mirror, operation.repeat) + [alike(state)] * operation.repeat
    every = locked(state, dict.fromkeys(parts, change), links)
    cage = Cage.of(
        {part: every[part](cuboid) if part in every else cuboid for part, cuboid in state.cage.cuboids().items()}
    )
    return state.with_cage(attached(state.cage, cage, every.keys()) if operation.attach else cage)


def _moved_in_own_frame(state: State, by: tuple[float, float, float]) -> Change:
    local = np.zeros(3)
    for axis, length in zip("xyz", by):
        row, sign = state.own_axis(axis)
        local[row] = sign * length * state.similarity.scale
    return lambda cuboid: replace(cuboid, centre=cuboid.centre + local @ cuboid.axes)


def _stretched(state: State, operation: Resize) -> Change:
    row, sign = state.own_axis(operation.axis)
    share = sign * ENDS[operation.keep] * (operation.factor - 1)
    factors = np.ones(3)
    factors[row] = operation.factor
    return lambda cuboid: Cuboid(
        cuboid.centre + share * cuboid.size[row] * cuboid.axes[row], cuboid.axes, cuboid.size * factors
    )


def _stretched_together(state: State, parts: tuple[str, ...], operation: Resize) -> Change:
    row, sign = state.own_axis(operation.axis)
    low, high = _box(state.cage, parts)
    fixed = (low + high) / 2 - sign * ENDS[operation.keep] * (high - low)
    factors = np.ones(3)
    factors[row] = operation.factor

    def change(cuboid: Cuboid) -> Cuboid:
        about = scaled_cage(Cage.of({"": replace(cuboid, centre=cuboid.centre - fixed)}), factors)[""]
        return replace(about, centre=about.centre + fixed)

    return change


def _turned(state: State, operation: Rotate) -> Change:
    row, sign = state.own_axis(operation.axis)

    def change(cuboid: Cuboid) -> Cuboid:
        return replace(cuboid, axes=cuboid.axes @ _rotation(sign * cuboid.axes[row], operation.angle).T)

    return change


def _turned_together(state: State, parts: tuple[str, ...], operation: Rotate) -> Change:
    rotation = _rotation(state.direction(operation.axis), operation.angle)
    low, high = _box(state.cage, parts)
    pivot = (low + high) / 2
    return lambda cuboid: replace(
        cuboid, centre=rotation @ (cuboid.centre - pivot) + pivot, axes=cuboid.axes @ rotation.T
    )


def _rotation(axis: Float[ndarray, " 3"], degrees: float) -> Float[ndarray, "3 3"]:
    return Rotation.from_rotvec(np.deg2rad(degrees) * axis).as_matrix()


def _box(cage: Cage, parts: tuple[str, ...]) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]:
    """Lowest and highest corner of the parts together, canonical."""
    corners = Cage.of({part: cage[part] for part in parts}).corners().reshape(-1, 3)
    return corners.min(axis=0), corners.max(axis=0)


def _sound(state: State) -> State:
    """The state, if its cuboids can be asked for a surface."""
    reach = np.abs(state.cage.corners()).max(axis=(1, 2))
    least = state.cage.size.min(axis=1)
    names = part_names(state.structure)
    unit = state.similarity.scale
    if not (reach.max() <= REACH):
        part = state.cage.part_ids[int(reach.argmax())]
        raise InputError(f"it takes {names[part]} {reach.max() / unit:.3g} away; wanted at most {REACH / unit:.3g}")
    if not (least.min() >= SMALLEST):
        part = state.cage.part_ids[int(least.argmin())]
        raise InputError(f"it leaves {names[part]} {least.min() / unit:.2g} thin; wanted {SMALLEST / unit:.2g} or more")
    return _sound_details(state)


def _sound_details(state: State) -> State:
    """The state, if the network can be evaluated in the cuboids in which details have the size that they keep."""
    unit = state.similarity.scale
    for part, lengths in state.kept.items():
        if not (lengths.min() >= SMALLEST and lengths.max() <= 4 * REACH):
            box = " x ".join(f"{length / unit:.3g}" for length in lengths)
            name = part_names(state.structure)[part]
            raise InputError(
                f"details of {name} would keep the size that they have in a cuboid of {box}; wanted lengths "
                f'from {SMALLEST / unit:.2g} to {4 * REACH / unit:.3g}, or details "stretch"'
            )
    return state
