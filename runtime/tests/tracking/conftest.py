import sys
from pathlib import Path

import pytest

# Tests are imported by path, not as a package.
sys.path.insert(0, str(Path(__file__).parent))

from stones_and_bodies import BODIES


@pytest.fixture(scope="session")
def bodies():
    return BODIES


@pytest.fixture(scope="session")
def anymal():
    return BODIES["anymal_c"][0]
