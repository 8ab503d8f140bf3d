"""How much memory data may take: what the environment says, or half the machine's."""

import pytest

from pipeline.errors import SettingError
from pipeline.memory import installed, memory


@pytest.mark.parametrize(("text", "size"), [("500M", 500 * 2**20), ("8g", 8 * 2**30), ("1.5GB", 3 * 2**29), ("7", 7)])
def test_a_size_is_read_with_its_unit(text: str, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_MEMORY", text)
    assert memory() == size


def test_without_a_limit_it_is_half_the_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CAGESDF_MEMORY", raising=False)
    assert memory() == installed() // 2 > 2**28


@pytest.mark.parametrize("text", ["much", "-3G", "4 X"])
def test_what_is_no_size_is_refused_by_name(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGESDF_MEMORY", text)
    with pytest.raises(SettingError, match=r"CAGESDF_MEMORY: wanted a size such as 500M or 8G"):
        memory()
