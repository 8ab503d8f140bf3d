"""Chromium, for the tests of the editor and the benchmarks that drive it."""

import os
import shutil
import subprocess

import pytest

FLAGS = (
    "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
    "--disable-quic", "--disable-extensions",
)  # fmt: skip
NAMES = ("chromium", "chromium-browser", "google-chrome")


def chromium() -> str:
    """Where it is; installed if it can be."""
    for name in (os.environ.get("CAGESDF_CHROMIUM"), *NAMES):
        if name and (found := shutil.which(name)):
            return found
    said = "there is no apt-get"
    if shutil.which("apt-get"):
        done = subprocess.run(
            ["apt-get", "install", "-y", "-qq", "chromium"], capture_output=True, text=True, check=False
        )
        said = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "apt-get says nothing"
        if found := shutil.which("chromium"):
            return found
    reason = f"no Chromium, and it can't be installed: {said}"
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)
