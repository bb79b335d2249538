import time

import numpy as np

from legtool_runtime.motion.planning.clock import CLOCK, NEVER, WATCH, late, now, watch_from_now


def test_compiled_code_and_python_read_one_clock():
    watch = np.zeros(WATCH, np.int64)
    before = time.clock_gettime_ns(CLOCK)
    read = now(watch)
    assert before <= read <= time.clock_gettime_ns(CLOCK)


def test_it_is_late_when_another_pause_as_long_as_the_longest_would_end_past_the_deadline():
    watch = np.zeros(WATCH, np.int64)
    deadline = time.clock_gettime_ns(CLOCK) + 60_000_000_000
    watch_from_now(watch, deadline)
    assert not late(watch, deadline)
    watch[2] -= 90_000_000_000  # as if the last reading had been a minute and a half ago
    assert late(watch, deadline) and time.clock_gettime_ns(CLOCK) < deadline
    watch_from_now(watch, deadline)
    assert not late(watch, deadline)  # pauses before that are forgotten


def test_a_deadline_that_has_passed_is_late():
    watch = np.zeros(WATCH, np.int64)
    watch_from_now(watch, 0)
    assert late(watch, 0)


def test_without_a_deadline_the_clock_is_not_read():
    watch = np.full(WATCH, -7, np.int64)
    watch_from_now(watch, NEVER)
    assert not late(watch, NEVER)
    assert (watch == -7).all()
