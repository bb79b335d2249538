"""A made-up walker with linear motion models, and maps for it to walk on."""

import numpy as np

from legtool_runtime.motion.features import FEATURES
from legtool_runtime.motion.model import MotionModel, MotionState
from legtool_runtime.robot import TROT_PAIRS, Robot
from legtool_runtime.terrain.costmap import costmap_from_mask

#: The paper's bare check of footholds, with nothing on top.
BARE = {"d_max_m": 0.06, "margin_m": 0.0, "steering_rad_s": 0.0}
STANCE = np.array([[0.24, 0.134, -0.36], [0.24, -0.134, -0.36], [-0.24, 0.134, -0.36], [-0.24, -0.134, -0.36]])
ROBOT = Robot(
    name="walker",
    hips=STANCE * [1, 0.4, 0],
    abduction_offset=[0.08, -0.08, 0.08, -0.08],
    thigh_length=[0.25] * 4,
    shank_length=[0.25] * 4,
    knee_sign=[-1] * 4,
    joint_limits=[[[-1.2, 1.2], [-2.0, 4.0], [-2.7, -0.6]]] * 4,
    foot_radius=0.0265,
    stance=STANCE,
)
STEP_TIME = 0.34


def parameters(*, noise=(0.009, 0.004, 0.03), weights=1e-4, degree=1, rng=None):
    """Velocity follows the reference with a lag, feet land ahead of the hips; ``rng`` perturbs it."""
    at = {name: i for i, name in enumerate(FEATURES)}
    cvm, cdm, fdm = np.zeros((3, 24)), np.zeros((4, 24)), np.zeros((6, 24))
    offset = np.zeros(6)
    for row, axis in enumerate(("x", "y", "yaw")):
        cvm[row, at[f"velocity_{axis}"]] = 0.35
        cvm[row, at[f"reference_{axis}"]] = 0.6
        cvm[row, at[f"previous_reference_{axis}"]] = 0.05
    for row, source, axis in ((0, 0, "x"), (1, 1, "y"), (3, 2, "yaw")):
        cdm[row] = 0.5 * STEP_TIME * cvm[source]
        cdm[row, at[f"velocity_{axis}"]] += 0.5 * STEP_TIME
    for side, leg in enumerate(("fl", "rr")):
        for i, axis in enumerate("xyz"):
            row = 3 * side + i
            fdm[row, at[f"foot_{leg}_{axis}"]] = -0.9
            offset[row] = 0.9 * STANCE[TROT_PAIRS[0][side], i]
            if i < 2:
                fdm[row] += cdm[i] + 0.5 * STEP_TIME * cvm[i]
    out = {}
    for name, coefficients, intercept, std in (
        ("fdm", fdm, offset, noise[0]),
        ("cdm", cdm, np.zeros(4), noise[1]),
        ("cvm", cvm, np.zeros(3), noise[2]),
    ):
        k, size = len(intercept), 25 if degree == 1 else 325
        full = np.zeros((k, size - 1))
        full[:, :24] = coefficients
        covariance = std**2 * np.eye(k)
        spread = weights * np.eye(size)
        if rng is not None:
            full[:, :24] += rng.normal(0, 0.02, (k, 24))
            full[:, 24:] += rng.normal(0, 0.005, (k, size - 25))
            intercept = intercept + rng.normal(0, 0.005, k)
            mix = rng.normal(0, 1, (k, k))
            covariance = std**2 * (np.eye(k) + 0.3 * mix @ mix.T / k)
            mix = rng.normal(0, 1, (size, 8))
            spread = weights * (mix @ mix.T)
        out[f"{name}.coefficients"] = full
        out[f"{name}.intercept"] = intercept
        out[f"{name}.noise_covariance"] = covariance
        out[f"{name}.weights_covariance"] = spread
    return out


def model(**how):
    instant = how.pop("instant", "full_stance_end")
    return MotionModel(parameters(**how), degree=how.get("degree", 1), instant=instant)


def standing(pair=0, speed=0.0):
    velocity = [speed, 0.0, 0.0]
    return MotionState(velocity, velocity, velocity, STANCE, pair)


def strip(*gaps, resolution=0.02, length=8.0, width=2.0, unknown_unsafe=False):
    """A costmap from x = -2 m on, with gaps (x from, to) or (x from, to, y from, to)."""
    nx, ny = round(length / resolution), round(width / resolution)
    x = -2.0 + (np.arange(nx) + 0.5) * resolution
    y = -0.5 * width + (np.arange(ny) + 0.5) * resolution
    unsafe = np.zeros((nx, ny), bool)
    for low, high, *sides in gaps:
        right, left = sides or (-9.0, 9.0)
        unsafe |= ((x >= low) & (x < high))[:, None] & ((y >= right) & (y < left))[None]
    return costmap_from_mask(unsafe, resolution, center=(0.5 * length - 2.0, 0.0), unknown_unsafe=unknown_unsafe)


def walk(planner, truth, costmap, goal, *, steps, seed, noise=1.0, start=0.0):
    """Close the loop over the models themselves, with their own noise.

    Returns how far it came along x [m], how many feet landed on unsafe cells, and the plans.
    """
    rng = np.random.default_rng(seed)
    position, rotation = np.array([start, rng.uniform(-0.03, 0.03), 0.36]), np.eye(3)
    velocity, previous, reference = np.zeros(3), np.zeros(3), np.zeros(3)
    feet = position + STANCE + rng.normal(size=(4, 3)) * [0.02, 0.005, 0.0]
    pair, missteps, plans = int(rng.integers(2)), 0, []
    for _ in range(steps):
        if position[0] > goal.x - 0.2:
            break
        state = MotionState(velocity, previous, reference, (feet - position) @ rotation, pair)
        plan = planner.plan(state, costmap, position=position, rotation=rotation, goal=goal)
        plans.append(plan)
        step = truth.predict(state, plan.command[None])
        draw = [
            mean[0] + noise * rng.normal(size=std[0].shape) * std[0]
            for mean, std in zip(step[:3], step[3:], strict=True)
        ]
        feet = feet + draw[0] @ rotation.T
        position = position + rotation @ draw[1][:3]
        c, s = np.cos(draw[1][3]), np.sin(draw[1][3])
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ rotation
        previous, velocity, reference = velocity, draw[2], plan.command
        missteps += int((costmap.distance_at(feet[list(TROT_PAIRS[pair])]) <= 0).sum())
        pair = 1 - pair
    return position[0], missteps, plans
