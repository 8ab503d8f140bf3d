"""`matches/`: matches come back as they were, sorted by source."""

from pathlib import Path

from cagesdf.deformation.matching import Match
from cagesdf.io.matches import read_matches, write_matches

MATCHES = [
    Match("b", "a", (1.0, 1.0, 1.0), (("p", "q"), ("r", "s")), 0.25, 3, "drawn from 3 of equal structure"),
    Match("a", None, (0.8, 1.1, 1.2), (("p", "p"),), 0.1, 0, "no shape of equal structure: scaled"),
]


def test_matches_come_back_exactly_and_sorted(tmp_path: Path) -> None:
    write_matches(tmp_path, MATCHES)
    assert read_matches(tmp_path) == MATCHES[::-1]


def test_the_order_of_writing_does_not_change_the_bytes(tmp_path: Path) -> None:
    for name, matches in (("x", MATCHES), ("y", MATCHES[::-1])):
        (tmp_path / name).mkdir()
        write_matches(tmp_path / name, matches)
    assert (tmp_path / "x/matches.parquet").read_bytes() == (tmp_path / "y/matches.parquet").read_bytes()
