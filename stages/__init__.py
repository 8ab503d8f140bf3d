"""The stages, one thin file each. `dvc.yaml` says where their files lie."""

import os

# Before torch starts its threads: at the default they spin so long for one another that a second
# busy process makes training six times slower. Changes no result.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")
