from collections import Counter

import numpy as np
import pytest
import reference_planner
import walker

from legtool_runtime.motion.model import MotionState
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings, forward_commands, planar_commands
from legtool_runtime.terrain.costmap import costmap_from_mask

SMALL_3D = planar_commands((-0.2, 0.0, 0.5), (0.0, 0.2), (-0.4, 0.0))


def random_planner(rng, commands):
    settings = PlannerSettings(
        horizon=int(rng.integers(1, 4)),
        deadline_s=None,
        d_max_m=rng.uniform(0, 0.15),
        margin_m=rng.choice([0.0, 0.01, 0.03]),
        misstep_cost_m=rng.choice([0.0, 0.5, 1.0, 3.0]),
        goal_tolerance_m=rng.uniform(0.02, 0.3),
        waiting_cost_m=rng.choice([0.0, 0.05, 0.2]),
        max_velocity_change=rng.choice([0.3, 0.5, 2.0]),
        cell_m=rng.choice([0.01, 0.04]),
        steering_rad_s=0.0,
    )
    degree = 2 if rng.random() < 0.1 else 1
    return Planner(walker.model(rng=rng, degree=degree), walker.ROBOT, commands=commands, settings=settings)


def random_task(rng):
    size = (int(rng.integers(80, 120)), int(rng.integers(60, 100)))
    unsafe = rng.random(size) < rng.choice([0.0, 0.003, 0.02, 0.1, 0.6])
    if rng.random() < 0.5:
        at = int(rng.integers(40, size[0] - 12))
        unsafe[at : at + int(rng.integers(3, 12)), : int(rng.integers(10, size[1]))] = True
    costmap = costmap_from_mask(unsafe, 0.02, center=(0.5, 0.0), unknown_unsafe=bool(rng.random() < 0.5))
    yaw, roll, pitch = rng.uniform(-0.5, 0.5), *rng.normal(0, 0.03, 2)
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    tilt = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    state = MotionState(
        rng.normal((0.3, 0.0, 0.0), 0.3),
        rng.normal((0.3, 0.0, 0.0), 0.3),
        [rng.choice(np.arange(11) * 0.1), 0, 0],
        walker.STANCE + rng.normal(0, 0.03, (4, 3)),
        int(rng.integers(2)),
    )
    goal = Goal(
        rng.uniform(0, 1.5),
        rng.uniform(-0.5, 0.5),
        rng.uniform(-1, 1) if rng.random() < 0.3 else None,
        rng.uniform(0, 1.2) if rng.random() < 0.2 else None,
    )
    place = {"position": np.array([rng.uniform(-0.2, 0.4), rng.uniform(-0.3, 0.3), 0.36]), "rotation": turn @ tilt}
    return state, costmap, {**place, "goal": goal}


def compare(rng, commands, planners, tasks):
    counts = Counter()
    for _ in range(planners):
        planner = random_planner(rng, commands)
        for _ in range(tasks):
            state, costmap, task = random_task(rng)
            expected = reference_planner.plan(planner, state, costmap, **task)
            plan = planner.plan(state, costmap, **task)
            assert (plan.status, plan.blocked_leg, plan.generated) == (expected[0], expected[3], expected[4])
            np.testing.assert_array_equal(plan.commands, expected[1])
            np.testing.assert_allclose(plan.cost, expected[2], atol=1e-9)
            counts[plan.status] += 1
    assert all(counts[status] > 0.02 * planners * tasks for status in ("goal", "horizon", "blocked")), counts


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    Planner(walker.model(), walker.ROBOT).warm_up()  # compiling would use up the deadlines


@pytest.mark.parametrize("seed", range(4))
def test_forward_plans_are_those_of_the_plain_algorithm(seed):
    compare(np.random.default_rng(seed), forward_commands(), planners=10, tasks=52)


def test_plans_with_turns_are_those_of_the_plain_algorithm():
    compare(np.random.default_rng(99), SMALL_3D, planners=8, tasks=25)
