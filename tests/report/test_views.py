"""Views in 3-D: a file a grid that needs no other, the same for the same scenes; a picture leads to its own place."""

import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from cagesdf.report.views import write_views
from tests.support.scenes import grid

ROOT = Path(__file__).parents[2]
IMPORTS = "from pathlib import Path; from cagesdf.report.views import write_views; from tests.support.scenes import TWO"


def test_every_scene_has_its_place_in_a_file_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "views").mkdir()
    [addresses] = write_views(tmp_path / "views", [("balls", grid())])
    assert [[address is not None for address in row] for row in addresses] == [[True, False], [True, True]]
    found = [urlsplit(address) for row in addresses for address in row if address]
    assert {url.path for url in found} == {"views/balls.html"}
    assert (tmp_path / found[0].path).is_file()
    places = [tuple(map(float, parse_qs(url.query)["initialCameraLookAt"][0].split(","))) for url in found]
    assert len(set(places)) == len(found)


def test_equal_scenes_give_equal_bytes_in_any_number_of_processes_and_files_ask_for_no_other(tmp_path: Path) -> None:
    texts = []
    for seed, processes in (("1", 1), ("2", 2)):  # the seed of Python's hashes, which differ between processes
        (tmp_path / seed).mkdir()
        code = f"{IMPORTS}; write_views(Path({str(tmp_path / seed)!r}), TWO, {processes})"
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=ROOT)
        texts.append([path.read_text(encoding="utf-8") for path in sorted((tmp_path / seed).iterdir())])
    assert texts[0] == texts[1]
    assert not re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="https?://', texts[0][0])
