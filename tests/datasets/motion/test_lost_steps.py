from legtool.datasets.motion.lost_steps import lost_steps


def test_the_share_of_lost_steps_is_said_with_the_causes_that_cost_most() -> None:
    counts = {
        "steps": 40, "steps_without_history": 20, "stumble_short_step": 30, "stumble_slip": 4, "cut_off": 5,
        "stumble_single_foot": 1, "standing_s": 1000.0, "command_changes": 500,
    }  # fmt: skip
    (line,) = lost_steps(counts)
    assert line == (
        "  60 of 100 swings (60%) are no usable step: 30 shorter than transitions.min_step_s, as steps of a fast gait "
        "may be; 20 the step before is not usable, or there is none; 5 the recording begins or ends within; 5 by others"
    )


def test_a_small_share_is_not_worth_a_line() -> None:
    assert lost_steps({"steps": 95, "stumble_slip": 5}) == []
    assert lost_steps({"samples": 1000}) == []
