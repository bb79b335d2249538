"""Robots of the presets' size, and the modules that these tests share."""

import dataclasses
import sys
from pathlib import Path

import pytest

# Tests are imported by path, not as a package.
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tracking"))

from stones_and_bodies import BODIES

from legtool_runtime.search.pips import Pips
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


def patient(settings):
    """Settings with which no machine's load changes what is found: one pass, and time for it."""
    return dataclasses.replace(settings, feet=dataclasses.replace(settings.feet, weights=(3.0,), deadline_s=4.0))


@pytest.fixture(scope="session")
def walker(anymal, settings):
    """A planner that takes its time."""
    return Pips(anymal, patient(settings))
