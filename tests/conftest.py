"""Shared by all tests: where the real data lies."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real logs beside the repository; absent in a plain clone."""
    if not SHARED.is_dir():
        pytest.skip("real robot logs are not beside this checkout (../shared/data)")
    return SHARED
