"""A training that was stopped, in one file that is whole or not there.

The folder's name is a digest of everything the result depends on, so a checkpoint of other
parameters, data or code is never taken up.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
from safetensors.torch import load_file, save
from torch import Tensor

from cagesdf.errors import InputError

KEY = "cagesdf"
VERSION = 1
SNAPSHOT = ".snapshot.safetensors"


class Checkpoint:
    """Tensors and facts of a training under way, in `folder`; nothing is made before the first `save`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "training.safetensors"

    def save(self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """Replace what was saved before. A process killed at any moment leaves the old file or the new."""
        self._write(self.path, tensors, {KEY: json.dumps({"version": VERSION, **facts}, sort_keys=True)})

    def keep(self, steps: int, tensors: Mapping[str, Tensor]) -> None:
        """Write a snapshot of the weights after `steps` steps."""
        self._write(self.folder / f"{steps:08d}{SNAPSHOT}", tensors, {})

    def kept(self) -> dict[int, dict[str, Tensor]]:
        """Snapshots, by steps."""
        paths = sorted(self.folder.glob("*" + SNAPSHOT))
        return {int(path.name.removesuffix(SNAPSHOT)): load_file(path) for path in paths}

    def _write(self, path: Path, tensors: Mapping[str, Tensor], facts: dict[str, str]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        with partial.open("wb") as file:
            file.write(save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}, facts))
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """The state that was last saved, on the CPU; None if there is none.

        Raises InputError for a file that isn't one of ours.
        """
        if not self.path.is_file():
            return None
        try:
            with safetensors.safe_open(self.path, framework="pt") as file:
                facts = json.loads((file.metadata() or {})[KEY])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        except (safetensors.SafetensorError, KeyError, json.JSONDecodeError) as error:
            raise InputError(f"{self.path}: is no checkpoint of this project ({error!r}); delete it") from error
        if facts.pop("version", None) != VERSION:
            raise InputError(f"{self.path}: is a checkpoint of another version, wanted {VERSION}; delete it")
        return tensors, facts

    def step(self) -> int | None:
        """After how many steps the last save was; None if there is none. Raises InputError as `load` does."""
        saved = self.load()
        return None if saved is None else int(saved[1]["step"])

    def remove(self) -> None:
        """Delete the folder, if there is one."""
        shutil.rmtree(self.folder, ignore_errors=True)


def digest_of(facts: Mapping[str, Any]) -> str:
    """Twenty hexadecimal digits that change with anything in `facts` (JSON values)."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]
