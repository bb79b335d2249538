"""The chain from regions to contact plans: walks to goals, keeps what it began, and answers whatever comes."""

import dataclasses
import math

import numpy as np
import pytest
from plain_search import Plain
from true_regions import cut, rectangle, regions_of

from legtool_runtime.errors import PlannerError
from legtool_runtime.robot import Robot
from legtool_runtime.search.candidates import find_candidates
from legtool_runtime.search.feet import FootProblem
from legtool_runtime.search.pips import Pips
from legtool_runtime.search.recall import Recall
from legtool_runtime.search.settings import GAITS, CandidateSettings, PipsSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan


def patient(settings):
    return dataclasses.replace(settings, feet=dataclasses.replace(settings.feet, weights=(3.0,), deadline_s=4.0))


UP = np.tile([0.0, 0.0, 1.0], (4, 1))
FLOOR = [rectangle((0, 0, 0), (8, 8))]


@pytest.fixture
def pips(walker):
    walker.reset()
    return walker


def at_rest(robot, x=0.0, y=0.0):
    return robot.stance * [1.0, 1.0, 0.0] + [x, y, 0.0]


def ask(pips, faces=FLOOR, goal=(5.0, 0.0), time_s=0.0, plan=None, feet=None, **others):
    feet = at_rest(pips.robot) if feet is None else feet
    values = {"position": [*feet[:, :2].mean(axis=0), 0.55], "yaw": 0.0, **others}
    return pips.plan(regions_of(faces), feet=feet, goal=goal, time_s=time_s, plan=plan, **values)


def walk(pips, faces, goal, *, every=0.3, most=200, reshape=None, start=(0.0, 0.0)):
    """A robot that tracks perfectly; the answers of all frames."""
    plan, out, now = None, [], 0.0
    feet = at_rest(pips.robot, *start)
    for frame in range(most):
        here = feet if plan is None else np.array([plan.last(leg, now).place for leg in range(4)])
        ahead = here[:2].mean(axis=0) - here[2:].mean(axis=0)
        answer = pips.plan(
            regions_of(faces if reshape is None else reshape(frame)),
            position=here.mean(axis=0) + np.array([0, 0, 0.55]),
            yaw=math.atan2(ahead[1], ahead[0]),
            feet=here,
            goal=goal,
            time_s=now,
            plan=plan,
        )
        out.append((now, plan, answer))
        plan, now = answer.plan, now + every
        if answer.status == "reached":
            break
    return out


def stones(rng, size=0.15):
    """Shores and a field of stones between them."""
    field = [
        rectangle((x, y, rng.uniform(-0.03, 0.03)), (size, size))
        for x in np.arange(0.65, 2.0, 0.2)
        for y in np.arange(-0.9, 0.95, 0.2)
        if rng.random() < 0.75
    ]
    return [rectangle((-0.7, 0, 0), (2.4, 2.4)), *field, rectangle((3.2, 0, 0), (2.4, 2.4))]


def test_it_walks_over_stones_and_every_transition_passes_an_independent_check(pips, anymal):
    transitions = 0
    for seed in range(3):
        pips.reset()
        frames = walk(pips, stones(np.random.default_rng(seed)), (3.4, 0.0))
        assert frames[-1][2].status == "reached", f"seed {seed}: {frames[-1][2].reason}"
        for _, _, answer in frames[::4]:
            steps = answer.feet
            if steps is None or not len(steps):
                continue
            _, surface = find_candidates(
                regions_of(stones(np.random.default_rng(seed))), position=steps.positions[0].mean(axis=0),
                settings=pips.settings.candidates,
            )  # fmt: skip
            points = np.concatenate([answer.candidates.points, steps.positions[0]])
            judge = Plain(anymal, pips.settings, points, np.zeros(len(points)), surface.ground, surface.trunk)
            for k in range(len(steps)):
                before, after = (tuple(steps.stances[k + i].tolist()) for i in range(2))
                swings = GAITS[steps.gait][steps.phases[k]][0]
                assert judge.fault(before, after, swings) == "", f"seed {seed}, transition {k}"
                transitions += 1
            ContactPlan(answer.plan.stances, robot=anymal)  # the tracker refuses none of it
    assert transitions > 50


def beams(inner):
    """Two platforms, and two beams of 0.2 m with their inner edges so far off the middle."""
    aside = inner + 0.1
    sides = [rectangle((0, y, 0), (2.0, 0.2)) for y in (aside, -aside)]
    return [rectangle((-2.5, 0, 0), (3, 4)), *sides, rectangle((2.5, 0, 0), (3, 4))]


@pytest.mark.parametrize("inner", [0.325, 0.425])
def test_it_turns_to_stand_astride_two_beams_and_crosses_them(anymal, inner):
    """QuadPiPS' parallel beams in both readings: too far apart for a robot that faces along them."""
    base = PipsSettings.of(anymal)
    feet = dataclasses.replace(base.feet, expansions=30, deadline_s=60.0)
    pips = Pips(anymal, dataclasses.replace(base, feet=feet))
    frames = walk(pips, beams(inner), (1.8, 0.0), start=(-1.6, 0.0), every=0.24, most=250)
    assert frames[-1][2].status == "reached", frames[-1][2].reason
    middle = [np.array([plan.last(leg, now).place for leg in range(4)]) for now, plan, _ in frames if plan is not None]
    turned = [
        abs(math.atan2(*(f[:2].mean(axis=0) - f[2:].mean(axis=0))[[1, 0]])) for f in middle if abs(f[:, 0].mean()) < 0.5
    ]
    assert turned and min(turned) > math.radians(50)


def test_a_robot_that_stands_searches_longer_where_its_usual_time_leads_nowhere(anymal):
    base = PipsSettings.of(anymal)
    faces = stones(np.random.default_rng(4))
    hasty = dataclasses.replace(base.feet, expansions=1, deadline_s=60.0)
    reached = {}
    for patience in (1, 64):
        pips = Pips(anymal, dataclasses.replace(base, feet=hasty, patience=patience))
        reached[patience] = walk(pips, faces, (3.4, 0.0), most=160)[-1][2].status == "reached"
    assert reached == {1: False, 64: True}


def test_what_some_frames_leave_out_is_remembered():
    """Of a floor in tiles each frame has a half: one frame has some of its footholds, twelve have nearly all."""
    rng, settings = np.random.default_rng(0), CandidateSettings(radius=1.0)
    tiles = list(cut(rectangle((0, 0, 0), (2, 2)), 0.25))
    recall = Recall()
    for _ in range(12):
        some = [tile for tile in tiles if rng.random() < 0.5]
        found, surface = find_candidates(regions_of(some), position=(0, 0, 0.5), settings=settings)
        recall.note(found)
    whole, _ = find_candidates(regions_of(tiles), position=(0, 0, 0.5), settings=settings)
    assert len(set(found.keys) & set(whole.keys)) < 0.7 * len(whole)
    assert len(set(recall.more(found, surface, settings.step).keys) & set(whole.keys)) > 0.9 * len(whole)
    recall.forget()
    assert recall.more(found, surface, settings.step) is found


def test_what_is_remembered_gives_way_to_what_is_seen():
    floor, step = [rectangle((0, 0, 0), (2, 2))], [rectangle((0, 0, 0), (2, 2)), rectangle((0.4, 0, 0.1), (0.4, 0.4))]
    settings = CandidateSettings(radius=1.0)
    recall = Recall()
    for _ in range(4):
        before, _ = find_candidates(regions_of(floor), position=(0, 0, 0.5), settings=settings)
        recall.note(before)
    part = [rectangle((-0.5, 0, 0), (1, 2))]
    less, surface = find_candidates(regions_of(part), position=(0, 0, 0.5), settings=settings)
    assert not set(before.keys) <= set(less.keys)
    assert set(before.keys) <= set(recall.more(less, surface, settings.step).keys)
    now, surface = find_candidates(regions_of(step), position=(0, 0, 0.5), settings=settings)
    more = recall.more(now, surface, settings.step)
    under = (np.abs(more.points[:, :2] - [0.4, 0]).max(axis=1) < 0.18) & (more.points[:, 2] < 0.05)
    assert not under.any()


def test_what_a_foot_has_begun_never_changes(pips):
    for now, before, answer in walk(pips, FLOOR, (2.0, 0.5)):
        if before is None:
            continue
        until = now + pips.settings.commit_s
        for old, new in zip(before.stances, answer.plan.stances, strict=True):
            for k, stance in enumerate(old):
                if k and old[k - 1].end_s < until:
                    assert new[k].place == pytest.approx(stance.place) and new[k].begin_s == stance.begin_s
                    assert new[k - 1].end_s == old[k - 1].end_s


def test_future_footholds_keep_their_keys_over_frames_of_a_standing_robot(pips):
    """Another segmentation in each of 20 frames, the same robot: at least 90 % of footholds stay."""
    rng, kept, of = np.random.default_rng(0), 0, 0
    plan, last = None, None
    for _ in range(20):
        faces = list(cut(rectangle((0.5, 0, 0), (5, 2)), rng.uniform(0.15, 0.25), rng.uniform(0, 0.2, 2)))
        answer = ask(pips, faces, plan=plan)
        keys = {(leg, key) for row in answer.feet.keys[1:] for leg, key in enumerate(row)}
        if last is not None:
            kept, of = kept + len(keys & last), of + len(last)
        plan, last = answer.plan, keys
    assert kept >= 0.9 * of


def test_a_foothold_that_vanishes_is_planned_anew(pips):
    first = ask(pips)
    lost = max((s for row in first.plan.stances for s in row if s.begin_s > 1.0), key=lambda s: -s.begin_s).place
    hole = [f for f in cut(FLOOR[0], 0.2) if np.abs(f[0][:2, 3] - lost[:2]).max() > 0.2]
    second = ask(pips, hole, time_s=0.1, plan=first.plan)
    assert second.status == "walking"
    assert min(np.hypot(*(s.place - lost)[:2]) for row in second.plan.stances for s in row[1:]) > 0.05


def test_a_refused_transition_is_not_planned_again_until_some_time_has_passed(pips):
    first = ask(pips)
    before, after = first.feet.positions[0], first.feet.positions[1]
    pips.refuse(before, after, time_s=0.0)
    moved = lambda a: {tuple(p.round(3)) for p in a.feet.positions[1][~a.feet.families[0]]}  # noqa: E731
    assert moved(ask(pips)) != moved(first)
    again = ask(pips, time_s=10.0)
    assert moved(again) == moved(first)


def test_it_says_when_it_is_there(pips):
    out = ask(pips, goal=(0.2, 0.0))
    assert out.status == "reached" and not out.plan.events()


@pytest.mark.parametrize(
    ("goal", "faces"),
    [
        ((3.0, 0.0), [rectangle((-0.5, 0, 0), (3, 3))]),  # over a pit
        ((3.0, 0.0), [rectangle((0, 0, 0), (1.3, 1.3))]),
    ],
)
def test_a_goal_over_a_pit_is_answered_in_words(pips, goal, faces):
    frames = walk(pips, faces, goal, most=60)
    last = frames[-1][2]
    assert last.status == "exhausted" and last.reason and "\n" not in last.reason
    assert all(np.abs(s.place[:2]).max() < 2.1 for row in last.plan.stances for s in row)


def test_a_goal_inside_a_wall_is_answered_in_words(pips):
    heights = np.zeros((200, 200), np.float32)
    heights[140:170, 70:130] = 1.0
    wall = HeightMap(heights, 0.02, np.zeros(2))
    plan, answer = None, None
    for frame in range(60):
        feet = at_rest(pips.robot) if plan is None else np.array([r[-1].place for r in plan.stances])
        answer = ask(pips, goal=(1.1, 0.0), plan=plan, feet=feet, time_s=6.0 * frame, elevation=wall)
        plan = answer.plan
    assert answer.status == "exhausted" and answer.reason
    assert feet[:, 0].max() < 0.8


@pytest.mark.parametrize(
    "values",
    [
        {"feet": np.full((4, 3), np.nan)},
        {"goal": (np.nan, 0.0)},
        {"position": (0.0, np.inf, 0.5)},
        {"yaw": np.nan},
        {"time_s": np.nan},
        {"goal": (1.0, 2.0, 3.0)},
        {"goal_yaw": np.nan},
        {"faces": [(np.eye(4), np.array([[0, 0], [0, 1], [1, 1.0], [1, 0]]))]},  # clockwise
        {"faces": [(np.eye(4), np.array([[0, 0], [2, 0], [1, 0.2], [0, 2.0]]))]},  # not convex
    ],
)
def test_what_cannot_be_used_is_refused_at_the_door_and_answered_in_mid_walk(pips, values):
    with pytest.raises(PlannerError) as refusal:
        ask(pips, **({"position": (0, 0, 0.55)} | values))
    assert "\n" not in str(refusal.value)
    plan = ask(pips).plan
    answer = ask(pips, **({"position": (0, 0, 0.55), "time_s": 0.1, "plan": plan} | values))
    assert answer.status == "exhausted" and answer.reason == str(refusal.value) and answer.plan is plan


def test_without_regions_nothing_leads_on(pips):
    out = ask(pips, [])
    assert out.status == "exhausted" and "no region" in out.reason and not out.plan.events()


def test_one_region_is_enough(pips):
    assert ask(pips, FLOOR).status == "walking"
    assert ask(pips, [rectangle((0, 0, 0), (0.2, 0.2))]).status == "exhausted"


def test_regions_upon_each_other_change_nothing(pips):
    one, twice = ask(pips), None
    pips.reset()
    twice = ask(pips, [*FLOOR, *FLOOR])
    assert twice.feet.positions == pytest.approx(one.feet.positions)


def test_coincident_candidates_change_no_path(pips):
    """Every candidate twice: the same way at the same cost."""
    found, surface = find_candidates(regions_of(FLOOR), position=(0, 0, 0.55), settings=pips.settings.candidates)
    once = found.near([[-0.3, 0.0], [0.8, 0.0]], 150)
    twice = once._of(np.repeat(np.arange(len(once)), 2))
    problem = lambda some: FootProblem(some, surface, at_rest(pips.robot), UP, np.array([0.4, 0.0, 0.55]))  # noqa: E731
    one, two = (pips._feet.plan(problem(some)) for some in (once, twice))
    assert two.status == one.status == "found" and len(one) >= 2
    assert two.cost == pytest.approx(one.cost)
    assert two.positions == pytest.approx(one.positions)


def test_feet_in_the_air_and_in_a_line_are_answered_in_words(pips):
    air = at_rest(pips.robot)
    air[2, 2] += 0.2
    assert "RL is 20 cm above the ground" in ask(pips, feet=air).reason
    line = np.array([[0.36, 0, 0], [0.12, 0, 0], [-0.12, 0, 0], [-0.36, 0, 0]])
    out = ask(pips, feet=line)
    assert out.status == "exhausted" and "plane" in out.reason
    assert ask(pips, feet=at_rest(pips.robot)[[0, 0, 2, 3]]).reason == "start: FL and FR stand at one place"
    apart = at_rest(pips.robot) * [2.5, 1, 1]
    out = ask(pips, feet=apart)
    assert out.status == "exhausted" and "out of reach" in out.reason


def test_a_robot_without_joint_limits_walks(anymal):
    free = Robot.from_dict({**anymal.to_dict(), "joint_limits": np.tile([-math.pi, math.pi], (4, 3, 1))})
    assert ask(Pips(free, patient(PipsSettings.of(free)))).status == "walking"


def test_a_small_robot_walks(go2):
    pips = Pips(go2, patient(PipsSettings.of(go2)))
    feet = at_rest(go2)
    out = pips.plan(regions_of(FLOOR), position=(0, 0, 0.32), yaw=0.0, feet=feet, goal=(3.0, 0.0), time_s=0.0)
    assert out.status == "walking" and out.feet.status == "found"
    assert out.feet.positions[-1, :, 0].mean() > 0.6


def test_a_small_robots_searches_go_with_its_size(anymal, go2):
    usual, small = PipsSettings.of(anymal), PipsSettings.of(go2)
    share = small.candidates.spacing / usual.candidates.spacing
    assert 0.6 < share < 0.8
    for name in ("cell", "least_way", "support", "uneven"):
        assert getattr(small.torso, name) == pytest.approx(share * getattr(usual.torso, name)), name
    pips = Pips(go2, patient(small))
    out = ask(pips, feet=at_rest(go2), position=(0.0, 0.0, 0.32))
    lifts = sorted({s.end_s for row in out.plan.stances for s in row if math.isfinite(s.end_s)})
    assert np.diff(lifts) == pytest.approx(math.sqrt(share) * 0.48)


def turned_by(answer):
    feet = np.array([row[-1].place for row in answer.plan.stances])
    ahead = feet[:2].mean(axis=0) - feet[2:].mean(axis=0)
    return math.atan2(ahead[1], ahead[0])


def test_it_turns_to_see_a_goal_beside_it_before_it_walks_past(anymal):
    """What a camera ahead has seen: ground to the front. Along it the robot would come no nearer to the goal."""
    ahead = [rectangle((0.7, -0.2, 0), (3.0, 1.4))]
    goal = (0.5, 1.4)
    base = patient(PipsSettings.of(anymal))
    there = {}
    for sight in (None, 0.7):
        out = ask(Pips(anymal, dataclasses.replace(base, sight=sight)), ahead, goal)
        there[sight] = turned_by(out), float(np.hypot(*out.feet.torso[-1, :2]))
    assert there[0.7][0] > 0.35 > there[None][0]
    assert there[0.7][1] < 0.25


def test_a_goal_ahead_is_not_looked_at(anymal):
    ahead = [rectangle((0.7, -0.2, 0), (3.0, 1.4))]
    base = patient(PipsSettings.of(anymal))
    usual, looks = (ask(Pips(anymal, dataclasses.replace(base, sight=s)), ahead, (3.5, 0.8)) for s in (None, 0.7))
    assert usual.feet.positions == pytest.approx(looks.feet.positions)


def test_it_looks_at_a_goal_that_it_cannot_see_a_few_times_only(anymal):
    ahead = [rectangle((0.7, -0.2, 0), (3.0, 1.4))]
    pips = Pips(anymal, dataclasses.replace(patient(PipsSettings.of(anymal)), sight=0.3))
    frames = walk(pips, ahead, (-0.5, 4.0), most=60, every=0.6)
    assert frames[-1][2].status == "exhausted"
    assert not frames[-1][2].plan.events() or frames[-1][2].plan.end_s < frames[-1][0]


def test_what_is_left_of_a_plan_is_kept_where_nothing_new_leads_on_unless_a_transition_of_it_is_refused(pips):
    first = ask(pips, goal=(1.5, 0.0))
    walls = HeightMap(np.ones((200, 200), np.float32), 0.02, np.zeros(2))  # no foothold left, and the regions are there
    kept = ask(pips, goal=(1.5, 0.0), plan=first.plan, elevation=walls)
    assert kept.status == "exhausted" and kept.plan is first.plan and not kept.changed
    pips.refuse(first.feet.positions[1], first.feet.positions[2], 0.0, ahead=True)
    after = ask(pips, goal=(1.5, 0.0), plan=first.plan, elevation=walls)
    assert after.status == "exhausted" and after.changed and not after.plan.events()


@pytest.mark.parametrize("sight", [0.0, -1.0, 4.0])
def test_a_sight_that_is_no_angle_is_refused(anymal, sight):
    with pytest.raises(PlannerError, match="sight"):
        dataclasses.replace(PipsSettings.of(anymal), sight=sight)


def test_the_papers_mode_walks_on_centroids(anymal):
    pips = Pips(anymal, patient(PipsSettings.of(anymal, "paper")))
    faces = list(cut(rectangle((0.5, 0, 0), (4, 2)), 0.2))
    out = ask(pips, faces)
    assert out.status == "walking" and out.feet.gait == "trot"
    middles = np.array([p[:2, 3] for p, _ in faces])
    for place in out.feet.positions[1:][~out.feet.families]:
        assert np.hypot(*(middles - place[:2]).T).min() < 1e-9


def test_the_deadline_is_kept_with_an_answer(anymal):
    """A field of many stones and a deadline of a millisecond: an answer, and nearly in time whatever runs beside."""
    base = PipsSettings.of(anymal)
    hurried = dataclasses.replace(base, feet=dataclasses.replace(base.feet, deadline_s=0.001))
    pips = Pips(anymal, hurried)
    pips.warm_up()
    late = []
    for seed in range(10):
        pips.reset()
        out = ask(pips, stones(np.random.default_rng(seed), 0.1))
        assert out.feet is not None and out.feet.status in ("found", "partial", "exhausted")
        assert out.feet.status != "exhausted" or out.feet.reason
        late.append(out.feet.planning_time_s)
    assert np.median(late) < 0.005


def test_settings_of_unknown_names_are_refused(anymal):
    with pytest.raises(PlannerError, match="walkable or paper"):
        PipsSettings.of(anymal, "fast")
    base = PipsSettings.of(anymal)
    with pytest.raises(PlannerError, match="gaits"):
        dataclasses.replace(base.feet, gaits=("gallop",))
    with pytest.raises(PlannerError, match="feet cross"):
        dataclasses.replace(base.walkability, width_off=1.0)
