import numpy as np
import pytest
from rigid_body import RigidBody
from scipy.spatial.transform import Rotation
from stones_and_bodies import BODIES, stones

from legtool_runtime.errors import TrackingError
from legtool_runtime.tracking.body_reference import ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.preview import BodyState, Preview
from legtool_runtime.tracking.settings import PreviewSettings

INF = float("inf")


def on_all_feet(robot, normals=None):
    ups = np.tile([0, 0, 1.0], (4, 1)) if normals is None else normals
    return ContactPlan([[Stance(-INF, INF, robot.stance[l] * [1, 1, 0], ups[l])] for l in range(4)])


def ready(name, plan, start_s=0.0, settings=None):
    robot, mass, inertia = BODIES[name]
    maker = ReferenceMaker(robot)
    reference = maker.from_contacts(plan, start_s=start_s)
    preview = Preview(mass=mass, inertia=inertia, height=maker.height, settings=settings)
    point = reference.at(start_s)
    return preview, reference, BodyState(point.position, point.velocity, point.rotation, point.angular_velocity), maker


@pytest.mark.parametrize("name", BODIES)
def test_standing_gives_gravity(name):
    robot, mass, _ = BODIES[name]
    plan = on_all_feet(robot)
    preview, reference, state, _ = ready(name, plan)
    found = preview.solve(state, reference, plan, 0.0)
    assert found.solved
    assert np.allclose(found.forces.sum(axis=1), [0, 0, mass * 9.81], atol=1e-3 * mass)
    assert np.allclose(found.forces[:, :, 2], 0.25 * mass * 9.81, rtol=0.02)
    assert np.abs(found.acceleration).max() < 1e-3
    assert np.abs(found.angular_acceleration).max() < 1e-2


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("tilted", [False, True])
def test_forces_stay_inside_their_cones(name, tilted):
    robot, mass, _ = BODIES[name]
    rng = np.random.default_rng(4)
    normals = np.tile([0, 0, 1.0], (4, 1)) + (0.25 * rng.normal(size=(4, 3)) * [1, 1, 0] if tilted else 0)
    plan = on_all_feet(robot, normals)
    preview, reference, state, _ = ready(name, plan)
    for _ in range(20):
        off = BodyState(
            state.position + rng.normal(size=3) * 0.05, rng.normal(size=3) * 0.5,
            Rotation.from_rotvec(rng.normal(size=3) * 0.15).as_matrix() @ state.rotation, rng.normal(size=3) * 0.8,
        )  # fmt: skip
        preview.forget()
        found = preview.solve(off, reference, plan, 0.0)
        assert found.solved
        for leg in range(4):
            normal = plan.stances[leg][0].normal
            up = found.forces[:, leg] @ normal
            across = np.linalg.norm(found.forces[:, leg] - up[:, None] * normal, axis=1)
            assert (up > 0.0999 * mass * 9.81).all()
            assert (across <= np.sqrt(2) * 0.5401 * up).all()


def test_forces_lean_along_the_normals_of_a_ridge():
    """Feet on the two sides of a ridge of 45°: with cones about z this stand does not exist."""
    robot, mass, _ = BODIES["anymal_c"]
    normals = np.array([[0, s, 1.0] for s in (1, -1, 1, -1)])
    plan = on_all_feet(robot, normals)
    preview, reference, state, _ = ready("anymal_c", plan)
    found = preview.solve(state, reference, plan, 0.0)
    assert found.solved
    assert found.forces[0, 0, 1] > 0.2 * found.forces[0, 0, 2]
    assert np.allclose(found.forces[0].sum(axis=0), [0, 0, mass * 9.81], atol=1.0)


def test_a_swinging_leg_carries_nothing_and_lateness_is_known(anymal):
    plan = plan_from_gait(GaitTiming.trot(), stones(anymal, 4, np.random.default_rng(0)), start_s=0.0)
    preview, reference, state, _ = ready("anymal_c", plan)
    found = preview.solve(state, reference, plan, 0.0)
    assert found.standing[0].tolist() == [False, True, True, False]
    assert (found.forces[:8][:, [0, 3]] == 0).all()
    assert found.times_s[8] == pytest.approx(0.40)
    assert found.times_s[10] == pytest.approx(0.48)  # nodes end where a foot lands or lifts
    assert found.standing[8:10].all()
    assert found.standing[10].tolist() == [True, False, False, True]
    waits = preview.solve(
        state, reference, plan, 0.42, standing=[False, True, True, True], late=[True, False, False, False]
    )
    assert waits.standing[0].tolist() == [False, True, True, True]
    assert not waits.standing[:2, 0].any()
    early = plan.touched_down(0, 0.3)
    assert preview.solve(state, reference, early, 0.3, standing=[True, True, True, False]).standing[0].tolist() == [
        True, True, True, False,
    ]  # fmt: skip
    swinging = preview.solve(state, reference, plan, 0.41, standing=[False, True, True, False])
    assert not swinging.standing[0, 0]
    assert swinging.standing[1, 0]


def test_what_cannot_be_solved_keeps_the_last_solution_and_says_so(anymal):
    plan = on_all_feet(anymal)
    preview, reference, state, _ = ready("anymal_c", plan)
    nan = state._replace(velocity=np.array([np.nan, 0, 0]))
    first = preview.solve(nan, reference, plan, 0.0)
    assert not first.solved
    assert first.forces[0, :, 2].sum() == pytest.approx(52.1 * 9.81)
    good = preview.solve(state, reference, plan, 0.0)
    kept = preview.solve(nan, reference, plan, 0.1)
    assert good.solved
    assert not kept.solved
    assert (kept.forces == good.forces).all()
    assert kept.node(0.12) == 2
    assert kept.node(99.0) == 19
    assert preview.solve(state, reference, plan, 0.2).solved


def test_starting_from_the_last_solution_finds_the_same(anymal):
    plan = plan_from_gait(GaitTiming.trot(), stones(anymal, 4, np.random.default_rng(0)), start_s=0.0)
    preview, reference, state, maker = ready("anymal_c", plan)
    for t in np.arange(0.0, 1.5, 0.02):
        reference = maker.from_contacts(plan, start_s=t)
        point = reference.at(t)
        state = BodyState(
            point.position + np.array([0.01, -0.01, 0]), point.velocity, point.rotation, point.angular_velocity
        )
        warm = preview.solve(state, reference, plan, t)
        cold = Preview(mass=52.1, inertia=BODIES["anymal_c"][2], height=maker.height).solve(state, reference, plan, t)
        assert warm.solved
        assert cold.solved
        assert np.abs(warm.forces - cold.forces).max() < 0.5


@pytest.mark.parametrize("change", [{"mass": -1.0}, {"height": float("nan")}, {"inertia": np.zeros((3, 3))},
                                    {"inertia": np.eye(2)}])  # fmt: skip
def test_no_body_is_refused(change):
    with pytest.raises(TrackingError, match="preview"):
        Preview(**{"mass": 50.0, "inertia": np.eye(3), "height": 0.5, **change})


@pytest.mark.parametrize("change", [{"nodes": 1}, {"node_s": 0.0}, {"effort": 0.0}, {"friction": float("nan")},
                                    {"least": (0.3, 0.1)}, {"tilt": -1.0}])  # fmt: skip
def test_settings_that_make_no_problem_are_refused(change):
    with pytest.raises(TrackingError, match="preview"):
        PreviewSettings(**change)


def walk(name, plan, *, settings=None, push=None, seconds=None, start_s=0.0):
    """Closed loop at 50 Hz on a rigid body with 2 ms steps; the worst errors of place [m] and tilt [rad]."""
    _, mass, inertia = BODIES[name]
    preview, reference, state, maker = ready(name, plan, start_s, settings)
    body = RigidBody(mass, inertia, state)
    worst, tilt, t = 0.0, 0.0, start_s
    end = plan.end_s + 1.0 if seconds is None else start_s + seconds
    feet = np.zeros((4, 3))
    while t < end:
        reference = maker.from_contacts(plan, start_s=t)
        found = preview.solve(body.state, reference, plan, t)
        assert found.solved
        for _ in range(10):
            standing = plan.standing(t)
            for leg in range(4):
                stance = plan.current(leg, t)
                if stance is not None:
                    feet[leg] = stance.place
            # A foot that the node takes for standing carries only while it does.
            forces = found.forces[found.node(t)] * standing[:, None]
            pushed = push[1] if push is not None and push[0] <= t < push[0] + 0.1 else np.zeros(3)
            body.step(forces, feet, 0.002, pushed)
            t += 0.002
        point = reference.at(t)
        worst = max(worst, float(np.linalg.norm(body.position - point.position)))
        off = Rotation.from_matrix(point.rotation.T @ body.rotation.as_matrix()).magnitude()
        tilt = max(tilt, float(off))
        assert worst < 0.3, f"fell at {t:.2f} s"
        assert tilt < 0.6, f"tipped over at {t:.2f} s"
    return worst, tilt, float(np.linalg.norm(body.position - point.position))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", BODIES)
def test_a_rigid_body_trots_over_stones(name, seed):
    robot = BODIES[name][0]
    scale = (robot.thigh_length[0] + robot.shank_length[0]) / 0.6125
    footholds = stones(robot, 8, np.random.default_rng(seed), stride=0.4 * scale, rise=0.1 * scale, most=0.2 * scale)
    timing = GaitTiming(swing_s=0.4 * np.sqrt(scale), full_stance_s=0.08 * np.sqrt(scale))
    worst, _, final = walk(name, plan_from_gait(timing, footholds, start_s=0.5))
    assert worst < 0.12 * scale
    assert final < 0.02


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["anymal_c", "go2"])
def test_a_rigid_body_crawls_over_stones(name, seed):
    robot = BODIES[name][0]
    scale = (robot.thigh_length[0] + robot.shank_length[0]) / 0.6125
    footholds = stones(robot, 3, np.random.default_rng(seed), stride=0.4 * scale, rise=0.1 * scale, most=0.2 * scale)
    timing = GaitTiming.crawl()
    worst, _, final = walk(name, plan_from_gait(timing, footholds, start_s=0.5), settings=PreviewSettings.crawl())
    assert worst < 0.12 * scale
    assert final < 0.02


@pytest.mark.parametrize("way", [(1, 0, 0), (0, 1, 0), (0, -1, 0), (-0.7, 0.7, 0)])
def test_a_push_of_half_a_metre_per_second_is_recovered_standing(way):
    robot, mass, _ = BODIES["anymal_c"]
    plan = on_all_feet(robot)
    _, _, final = walk("anymal_c", plan, push=(0.5, 0.5 * mass / 0.1 * np.array(way)), seconds=4.0)
    assert final < 0.01


@pytest.mark.parametrize("way", [(1, 0, 0), (0, 1, 0), (0, -1, 0)])
def test_a_push_of_150_newtons_is_recovered_trotting_on_stones(way, anymal):
    footholds = stones(anymal, 10, np.random.default_rng(5))
    plan = plan_from_gait(GaitTiming.trot(), footholds, start_s=0.5)
    _, _, final = walk("anymal_c", plan, push=(2.0, 150.0 * np.array(way)))
    assert final < 0.02
