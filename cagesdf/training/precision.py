"""Number format of the matrix products of a training: bfloat16 only where the processor multiplies it natively.

Elsewhere bfloat16 is emulated: a step takes seven times as long as in float32 on a processor with AVX2 alone.
"""

from collections.abc import Mapping
from typing import Literal

import torch

Precision = Literal["float32", "bfloat16"]

# Instructions that multiply bfloat16, by torch's names: of x86 processors, then of Arm's.
X86_BFLOAT16 = ("avx512_bf16", "amx_bf16")
ARM_BFLOAT16 = ("bf16", "sve_bf16")


def fitting_precision(precision: Literal["auto", "float32", "bfloat16"], device: str) -> Precision:
    """The precision to train with on a device ("cpu", "cuda", …): as given, or for "auto" the fastest that it has."""
    if precision != "auto":
        return precision
    if device.startswith("cuda"):
        native = torch.cuda.is_bf16_supported(including_emulation=False)
    elif device == "cpu":
        native = multiplies_bfloat16(
            torch.cpu.get_capabilities(),
            torch.backends.cpu.get_cpu_capability(),
            torch.ops.mkldnn._is_mkldnn_bf16_supported(),
        )
    else:
        native = False
    return "bfloat16" if native else "float32"


def multiplies_bfloat16(hardware: Mapping[str, bool | int | str], capability: str, onednn: bool) -> bool:
    """Whether a processor multiplies bfloat16 natively, and torch will let it.

    `hardware` is what the processor has (`torch.cpu.get_capabilities`), `capability` the instructions that torch's own
    kernels use (ATEN_CPU_CAPABILITY lowers it), `onednn` whether oneDNN takes bfloat16 at the instructions that it is
    allowed (ONEDNN_MAX_CPU_ISA lowers them).
    """
    if str(hardware.get("architecture", "")).startswith(("arm", "aarch")):
        return onednn and any(hardware.get(name) for name in ARM_BFLOAT16)
    return onednn and capability.startswith("AVX512") and any(hardware.get(name) for name in X86_BFLOAT16)


def processor() -> str:
    """This machine's processor in words, to stand beside every time: name, instructions that torch uses, threads."""
    hardware = torch.cpu.get_capabilities()
    bfloat16 = "with" if fitting_precision("auto", "cpu") == "bfloat16" else "without"
    return (
        f"{hardware.get('cpu_name', hardware['architecture'])}, {torch.backends.cpu.get_cpu_capability()} "
        f"{bfloat16} bfloat16, {torch.get_num_threads()} threads"
    )
