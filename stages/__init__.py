"""The stages, one thin file each. `dvc.yaml` says where their files lie."""

import os
import platform

# Before torch starts its threads: at the default they spin so long for one another that a second
# busy process makes training six times slower. Changes no result.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

# Before numpy is imported: its products of matrices then have the same bits on every x86 processor with AVX2. Left to
# itself, OpenBLAS has other kernels for AVX-512, and all artefacts from the first on differ in their last digits.
if platform.machine() in ("x86_64", "AMD64"):
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
