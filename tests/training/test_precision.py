"""The number format of a training fits the processor, and a run says which it was."""

import os
import subprocess
import sys

import pytest

from cagesdf.training.precision import fitting_precision, multiplies_bfloat16

PLAIN = {"architecture": "x86_64", "avx2": True, "avx512_f": True, "avx512_bf16": False, "amx_bf16": False}
BFLOAT16 = {**PLAIN, "avx512_bf16": True}
AMX = {**PLAIN, "amx_bf16": True}
ARM = {"architecture": "aarch64", "bf16": True}
OLD_ARM = {"architecture": "aarch64", "neon": True, "bf16": False, "sve_bf16": False}


@pytest.mark.parametrize(
    ("hardware", "capability", "onednn", "native"),
    [
        (BFLOAT16, "AVX512", True, True),
        (AMX, "AVX512", True, True),
        (PLAIN, "AVX512", True, False),
        ({"architecture": "x86_64", "avx2": True}, "AVX2", False, False),
        (BFLOAT16, "AVX2", True, False),  # torch was told to leave AVX-512 alone
        (BFLOAT16, "AVX512", False, False),  # oneDNN was
        (ARM, "DEFAULT", True, True),
        ({**OLD_ARM, "sve_bf16": True}, "SVE256", True, True),
        (OLD_ARM, "DEFAULT", True, False),
        (ARM, "DEFAULT", False, False),
    ],
)
def test_bfloat16_is_native_where_the_hardware_has_it_and_torch_uses_it(
    hardware: dict[str, bool | int | str], capability: str, onednn: bool, native: bool
) -> None:
    assert multiplies_bfloat16(hardware, capability, onednn) is native


def test_a_precision_that_is_asked_for_is_used_everywhere() -> None:
    for precision in ("float32", "bfloat16"):
        for device in ("cpu", "cuda", "mps"):
            assert fitting_precision(precision, device) == precision


def test_devices_that_nothing_is_known_of_get_float32() -> None:
    assert fitting_precision("auto", "mps") == "float32"


def test_three_variables_make_any_processor_a_plain_one() -> None:
    plain = {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2", "MKL_ENABLE_INSTRUCTIONS": "AVX2"}
    code = "from cagesdf.training.precision import fitting_precision; print(fitting_precision('auto', 'cpu'))"
    said = subprocess.run([sys.executable, "-c", code], env={**os.environ, **plain}, capture_output=True, check=True)
    assert said.stdout.decode().strip() == "float32"
