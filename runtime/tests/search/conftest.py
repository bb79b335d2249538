"""Robots of the presets' size, and the modules that these tests share."""

import sys
from pathlib import Path

import pytest

# Tests are imported by path, not as a package.
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tracking"))

from stones_and_bodies import BODIES

from legtool_runtime.search.settings import PipsSettings


@pytest.fixture(scope="session")
def anymal():
    return BODIES["anymal_c"][0]


@pytest.fixture(scope="session")
def go2():
    return BODIES["go2"][0]


@pytest.fixture(scope="session")
def settings(anymal):
    return PipsSettings.of(anymal)
