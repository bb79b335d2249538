"""What a check found: how bad it is, and one line that says what was compared, the figure, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple


class Finding(NamedTuple):
    """One disagreement within a log.

    Attributes:
        signal: name of the signal that is doubted, such as ``velocity``.
        level: ``refuse`` if models learned from this log would be wrong, ``warn`` if a part of it is doubtful.
        text: what was compared, the figure, the likely cause, and what to set.
        unfilled: whether the signal was never written, so that it can be derived instead.
    """

    signal: str
    level: Literal["refuse", "warn"]
    text: str
    unfilled: bool = False


def refused(findings: Sequence[Finding]) -> str | None:
    """The first finding for which a log is refused, and which other signals it would be refused for; None if none."""
    found = [finding for finding in findings if finding.level == "refuse"]
    if not found:
        return None
    others = list(dict.fromkeys(finding.signal for finding in found[1:] if finding.signal != found[0].signal))
    return found[0].text + (f" (doubtful too: {', '.join(others)})" if others else "")


def warnings(findings: Sequence[Finding]) -> list[str]:
    """The texts of all findings that are told."""
    return [finding.text for finding in findings if finding.level == "warn"]
