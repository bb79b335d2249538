import numpy as np
import pytest

from legtool_runtime.errors import StateError
from legtool_runtime.motion.tracker import StepTracker

FEET = np.array([[0.24, 0.13, -0.37], [0.24, -0.13, -0.37], [-0.24, 0.13, -0.37], [-0.24, -0.13, -0.37]])
FULL, FIRST, SECOND = [60, 60, 60, 60], [0, 120, 120, 0], [120, 0, 0, 120]


def feed(tracker: StepTracker, stages: list[tuple[list[float], float, list[float]]], *, dt: float = 0.01) -> None:
    """Ten measurements for each (forces, vx, reference)."""
    for index, (force, vx, reference) in enumerate(stages):
        for tick in range(10):
            tracker.update(
                (10 * index + tick) * dt, velocity=[vx, 0, 0], feet_base=FEET, contact_force=force, reference=reference
            )


def test_pairs_alternate_and_history_is_that_of_the_step_before() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8)
    feed(
        tracker,
        [(FULL, 0.1, [0.3, 0, 0]), (FIRST, 0.2, [0.4, 0, 0]), (FULL, 0.3, [0.4, 0, 0])],
    )
    state = tracker.state()
    assert tracker.full_stance
    assert state.swing_pair == 1
    assert state.velocity[0] == 0.3
    assert state.previous_velocity[0] == 0.1
    assert state.previous_reference[0] == 0.4


def test_the_command_given_in_full_stance_is_not_yet_history() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8)
    feed(tracker, [(FULL, 0.1, [0.3, 0, 0]), (SECOND, 0.2, [0.4, 0, 0]), (FULL, 0.3, [0.9, 0, 0])])
    assert tracker.state().swing_pair == 0
    assert tracker.state().previous_reference[0] == 0.4


def test_a_robot_that_stands_has_its_standing_as_history() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8, standing_s=0.15)
    feed(tracker, [(FIRST, 0.5, [0.5, 0, 0]), (FULL, 0.0, [0, 0, 0]), (FULL, 0.0, [0, 0, 0])])
    state = tracker.state()
    assert tracker.standing
    assert not state.previous_velocity.any()
    assert not state.previous_reference.any()


def test_a_force_between_the_thresholds_changes_nothing() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8)
    feed(tracker, [([10, 60, 60, 10], 0.0, [0, 0, 0])])
    assert tracker.full_stance
    feed(tracker, [([5, 60, 60, 5], 0.0, [0, 0, 0]), ([15, 60, 60, 15], 0.0, [0, 0, 0])])
    assert not tracker.full_stance


def test_thresholds_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(StateError, match="0 < contact_off < contact_on"):
        StepTracker(contact_on=5, contact_off=8)


def test_a_foot_that_bounces_begins_no_step_and_changes_no_history() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8)
    feed(tracker, [(FULL, 0.1, [0.3, 0, 0]), (FIRST, 0.2, [0.4, 0, 0])])
    bounce = [(FULL, 0.3, [0.4, 0, 0]), ([0, 60, 60, 60], 0.35, [0.4, 0, 0]), (FULL, 0.4, [0.4, 0, 0])]
    feed(tracker, [*bounce, ([0, 120, 120, 0], 0.45, [0.4, 0, 0]), (FULL, 0.5, [0.4, 0, 0])])
    assert tracker.steps == 1
    assert tracker.swing_pair == 1
    assert tracker.state().previous_velocity[0] == 0.1


def test_steps_are_counted_by_pairs_that_lift_off() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8, standing_s=0.15)
    feed(tracker, [(FULL, 0.0, [0, 0, 0]), (FIRST, 0.2, [0, 0, 0]), (FULL, 0.2, [0, 0, 0]), (SECOND, 0.2, [0, 0, 0])])
    assert tracker.steps == 2
    feed(tracker, [(FULL, 0.0, [0, 0, 0]), (FULL, 0.0, [0, 0, 0]), (SECOND, 0.2, [0, 0, 0])])  # after standing
    assert tracker.steps == 3


def test_what_it_knows_of_contact_and_was_made_with_can_be_asked() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8, first_pair=1)
    assert tracker.contact.tolist() == [True] * 4
    feed(tracker, [(FULL, 0.1, [0.3, 0, 0]), (FIRST, 0.2, [0.4, 0, 0])])
    assert tracker.contact.tolist() == [False, True, True, False]
    assert tracker.thresholds == {"contact_on": 20, "contact_off": 8, "first_pair": 1}


def test_states_at_touchdown_are_taken_as_a_pair_lands_also_without_full_stance() -> None:
    """A trot in which each pair lifts before the other has landed."""
    tracker = StepTracker(contact_on=20, contact_off=8, instant="touchdown")
    assert tracker.at_instant  # it stands
    landed = []
    flight = [[0, 0, 0, 0]] * 2
    for k, forces in enumerate([FULL] * 60 + ([FIRST] * 10 + flight + [SECOND] * 10 + flight) * 2):
        vx = 0.01 * k
        tracker.update(0.01 * k, velocity=[vx, 0, 0], feet_base=FEET, contact_force=forces, reference=[k, 0, 0])
        if k > 60 and tracker.at_instant:
            landed.append((k, tracker.swing_pair, tracker.steps))
            history = tracker.state().previous_velocity[0], tracker.state().previous_reference[0]
    # FIRST bears on FR and RL, so that pair 0 swings; at row 72 pair 0 lands and pair 1 is in the air already.
    assert landed == [(72, 1, 1), (84, 0, 2), (96, 1, 3)]
    assert history == (pytest.approx(0.84), 96)  # at the touchdown before, and in force until this one


def test_a_pair_that_bounces_lands_once_and_full_stance_is_no_instant_of_touchdown() -> None:
    tracker = StepTracker(contact_on=20, contact_off=8, instant="touchdown")
    rows = [*[FIRST] * 10, *[FULL] * 3, *[FIRST] * 2, *[FULL] * 10]
    at = []
    for k, forces in enumerate(rows):
        tracker.update(0.01 * k, velocity=[0, 0, 0], feet_base=FEET, contact_force=forces, reference=[0, 0, 0])
        at += [k] * tracker.at_instant
    assert at == [10]
    assert tracker.steps == 1


def test_an_unknown_instant_is_refused() -> None:
    with pytest.raises(StateError, match="instant is 'liftoff', expected touchdown or full_stance_end"):
        StepTracker(contact_on=20, contact_off=8, instant="liftoff")
