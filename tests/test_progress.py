"""Progress of long work."""

import pytest

from legtool import progress


@pytest.mark.parametrize(
    ("elapsed", "total", "line"),
    [
        (20.0, 100, "walking: 40 of 100 trials, 2.0 trials/s, 30 s left"),
        (800.0, 100, "walking: 40 of 100 trials, 3.0 trials/min, 20 min left"),
        (80000.0, 100, "walking: 40 of 100 trials, 1.8 trials/h, 33.3 h left"),
    ],
)
def test_slow_work_is_told_in_units_that_say_something(
    elapsed: float, total: int, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "_silent", False)
    with progress.progress("walking", total, "trials") as advance:
        now[0] = elapsed
        advance(40)
    assert capsys.readouterr().err.strip() == line
