"""Weights in safetensors files, and the descriptions of the networks that they belong to.

Sizes in a file are not trusted. Descriptions are bounded; the network that one describes is laid out
without memory (torch's meta device), and a file's header must have just its tensors before any of them is read.
"""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import safetensors
import torch
from torch import Tensor, nn

from cagesdf.errors import InputError

NUMBERS = "F32"  # safetensors' name of the number format of all weights
MAX_DESCRIPTION = 16_000_000  # bytes of JSON
MAX_WIDTH = 65_536  # units of a layer, numbers of a latent
MAX_LAYERS = 256

Sizes = dict[str, tuple[int, ...]]  # of tensors by name
Network = TypeVar("Network", bound=nn.Module)


def planned(make: Callable[[], Network]) -> Network:
    """The network that `make` builds, on the meta device: its tensors have sizes and no memory."""
    with torch.device("meta"):
        return make()


def sizes_of(network: nn.Module) -> Sizes:
    """The sizes of a network's tensors."""
    return {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}


def filled(network: Network, weights: Mapping[str, Tensor]) -> Network:
    """A planned network with weights of its `sizes_of`: on the CPU, in eval mode, without gradients."""
    network.to_empty(device="cpu").load_state_dict(weights)
    return network.eval().requires_grad_(False)


def read_header(path: Path) -> tuple[Sizes, dict[str, str]]:
    """The sizes of a file's tensors, and its metadata. No tensor is read.

    Raises InputError for a file that is missing or damaged, for tensors without numbers, and for numbers that aren't
    float32.
    """
    sizes: Sizes = {}
    with _opened(path) as file:
        for name in file.keys():  # noqa: SIM118 - no mapping
            part = file.get_slice(name)
            sizes[name] = tuple(part.get_shape())
            if part.get_dtype() != NUMBERS or 0 in sizes[name]:
                got = f"{part.get_dtype()} of size {list(sizes[name])}"
                raise InputError(f"{path}: its {name:.60} is {got}, wanted {NUMBERS}, and one number at least")
        return sizes, dict(file.metadata() or {})


def read_tensors(path: Path, sizes: Sizes) -> dict[str, Tensor]:
    """Tensors of the sizes that are wanted, float32, on the CPU.

    Raises InputError as `read_header` does, for a file that doesn't hold just these, before any is read, and for
    numbers that aren't finite.
    """
    present, _ = read_header(path)
    if present != sizes:
        name = next(name for name in sorted(present.keys() | sizes.keys()) if present.get(name) != sizes.get(name))
        got, wanted = (str(list(where[name])) if name in where else "none" for where in (present, sizes))
        what = f"{name:.60} has the size {got}, wanted {wanted}"
        raise InputError(f"{path}: doesn't hold the weights that are described: {what}; rerun the stage that wrote it")
    with _opened(path) as file:
        tensors = {name: file.get_tensor(name).clone() for name in sizes}
    if {name: tuple(tensor.shape) for name, tensor in tensors.items()} != sizes:
        raise InputError(f"{path}: changed while it was read")
    broken = [name for name, tensor in tensors.items() if not bool(tensor.isfinite().all())]
    if broken:
        raise InputError(f"{path}: its {broken[0]} has numbers that are not finite (NaN or infinite)")
    return tensors


def _opened(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        return safetensors.safe_open(path, framework="pt")
    except (safetensors.SafetensorError, OSError) as error:
        raise InputError(f"{path}: is damaged, or no safetensors file ({error})") from error


def read_description(path: Path) -> dict[str, Any]:
    """A JSON object in a file. Raises InputError if it is missing, too long or none."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.stat().st_size > MAX_DESCRIPTION:
        raise InputError(f"{path}: wanted at most {MAX_DESCRIPTION:,} bytes, got {path.stat().st_size:,}")
    return parse_description(path.read_bytes(), path)


def parse_description(text: str | bytes, path: Path) -> dict[str, Any]:
    """A JSON object. Raises InputError, with the file that it is from, if it is none."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is damaged, or no JSON ({error})") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: wanted a JSON object, got {str(content)[:60]}")
    return content


def whole(content: Mapping[str, Any], name: str, least: int, most: int, path: Path) -> int:
    """A whole number of a description. Raises InputError if it is none, or out of its bounds."""
    value = content.get(name)
    if type(value) is not int or not least <= value <= most:
        raise InputError(f"{path}: wanted {name} from {least} to {most:,}, got {str(value)[:60]}")
    return value


def wholes(content: Mapping[str, Any], name: str, least: int, most: int, path: Path) -> tuple[int, ...]:
    """A list of whole numbers, MAX_LAYERS at most. Raises InputError as `whole` does."""
    values = content.get(name)
    if not isinstance(values, list) or len(values) > MAX_LAYERS:
        raise InputError(f"{path}: wanted {name} to be a list of at most {MAX_LAYERS} numbers, got {str(values)[:60]}")
    return tuple(whole({name: value}, name, least, most, path) for value in values)


def positive(content: Mapping[str, Any], name: str, path: Path) -> float:
    """A positive, finite number of a description. Raises InputError if it is none."""
    value = content.get(name)
    if not isinstance(value, float) or not 0 < value < math.inf:
        raise InputError(f"{path}: wanted a positive {name}, got {str(value)[:60]}")
    return value
