"""Tuples of ViTAL as a robot meets them that moves over random terrain, labelled by the exact criteria."""

from __future__ import annotations

from typing import Any

import numpy as np

from legtool.configs.footholds import SAMPLES_PER_TERRAIN, TERRAINS_PER_PART, FootholdSettings
from legtool.datasets.foothold.heightmaps import FootholdData
from legtool.sim.worlds.terrain import CELL_M, SIDE_M, random_terrain
from legtool_runtime.foothold import SIZE, Criteria, Gait, Tuple, hip_heights
from legtool_runtime.foothold.gait import hip_velocity, nominal_foothold
from legtool_runtime.foothold.heightmap import extract_heightmap, nearest_safe
from legtool_runtime.foothold.settings import leg_length
from legtool_runtime.terrain.elevation import HeightMap

#: Longest way of the hip during a stance, as a share of the leg's length.
_STRIDE = 0.5


def foothold_samples(settings: FootholdSettings, index: int, criteria: Criteria) -> FootholdData:
    """A thousand samples, number ``index``: the same bits for the same settings, criteria and index, in any process.

    Args:
        settings: terrain, motion, flaws of the maps; its robot is not looked at.
        index: which thousand.
        criteria: that judge them, of one robot.
    """
    labeller = Labeller(settings, criteria)
    rows: list[dict[str, Any]] = []
    for number in range(index * TERRAINS_PER_PART, (index + 1) * TERRAINS_PER_PART):
        rng = np.random.default_rng([settings.seed, 4, number])
        kind = number % len(settings.terrains)
        scale = leg_length(criteria.robot) / 0.68
        heights = random_terrain(settings.terrains[kind], rng, scale=scale)
        world = HeightMap(heights.astype(np.float32), CELL_M, np.zeros(2))
        for _ in range(SAMPLES_PER_TERRAIN):
            rows.append({**labeller.sample(world, rng), "terrain": number, "terrain_kind": kind})
    return FootholdData(**{name: np.array([row[name] for row in rows]) for name in rows[0]})


class Labeller:
    """Draws tuples of one robot on a terrain and labels them."""

    def __init__(self, settings: FootholdSettings, criteria: Criteria) -> None:
        """Take what all samples share."""
        self.settings, self.criteria = settings, criteria
        self.hips = hip_heights(criteria.robot)

    def sample(self, world: HeightMap, rng: np.random.Generator) -> dict[str, Any]:
        """Draw one tuple from a terrain and label it; one row of :class:`FootholdData` but for the terrain."""
        s, robot = self.settings, self.criteria.robot
        vpa = rng.random() < s.vpa_share
        leg = int(rng.integers(4))
        twist = self.twist(rng)
        gait = random_gait(rng, float(np.hypot(twist[0], twist[1])), stride=_STRIDE * leg_length(robot))
        roll, pitch = self.attitude(rng)
        velocity = hip_velocity(robot, leg, twist.tolist(), roll=roll, pitch=pitch)
        nominal = np.zeros(2)
        if not vpa:
            # What feedback on the velocity, and a foothold chosen before, add to the foothold of steady walking.
            nominal = np.array(nominal_foothold(robot, leg, velocity, gait)) + rng.normal(scale=0.03, size=2)
        nominal = nominal.astype(np.float32)
        center = rng.uniform(-1, 1, 2) * (0.5 * SIDE_M - 0.5)
        heights = self.flaw(extract_heightmap(world, center, yaw=rng.uniform(-np.pi, np.pi)), rng)
        heights = (heights - np.median(heights[~np.isnan(heights)])).astype(np.float16)
        known = heights.astype(np.float32)
        standing = robot.standing_height + robot.hips[leg, 2]
        # Below hips, any of the heights that are counted over; around footholds, about the height of standing.
        tall = rng.uniform(self.hips[0], self.hips[-1]) if vpa else standing * rng.normal(1.0, 0.06)
        hip_height = float(np.float32(tall))
        cell = np.clip(np.round(-nominal / CELL_M).astype(int) + SIZE // 2, 0, SIZE - 1)
        ground = known[tuple(cell)]
        if not hip_height > ground:  # a block right below the hip: raise it above
            hip_height = float(np.float32((0.0 if np.isnan(ground) else ground) + standing))
        place = None if vpa else nominal.tolist()
        t = Tuple(
            known, leg=leg, hip_height=hip_height, base_twist=twist.tolist(), gait=gait, nominal=place,
            roll=roll, pitch=pitch,
        )  # fmt: skip
        judged = self.criteria.evaluate(t)
        best = nearest_safe(judged.safe, velocity)
        counts = self.criteria.counts(t, self.hips) if vpa else np.full(len(self.hips), -1)
        return {
            "heights": heights,
            "leg": leg,
            "hip_height": np.float32(hip_height),
            "base_twist": twist,
            "gait": np.array(
                [gait.step_length_m, gait.step_frequency_hz, gait.duty_factor, gait.time_to_touchdown_s], np.float32
            ),
            "nominal": nominal,
            "roll": np.float32(roll),
            "pitch": np.float32(pitch),
            "vpa": int(vpa),
            "reasons": judged.reasons,
            "optimal": -1 if best is None else best[0] * SIZE + best[1],
            "counts": counts,
        }

    def twist(self, rng: np.random.Generator) -> np.ndarray:
        """(6,) float32 a random base twist: mostly forward, some sideways and turning, a little of the rest."""
        s = self.settings
        speed = s.speed * np.sqrt(rng.random())
        direction = rng.normal(scale=0.4) if rng.random() < 0.7 else rng.uniform(-np.pi, np.pi)
        if rng.random() < 0.05:
            speed = 0.0
        turn = rng.uniform(-s.yaw_rate, s.yaw_rate) * (rng.random() < 0.6)
        linear = (speed * np.cos(direction), speed * np.sin(direction), rng.normal(scale=0.03))
        return np.array([*linear, *rng.normal(scale=0.05, size=2), turn], np.float32)

    def attitude(self, rng: np.random.Generator) -> tuple[float, float]:
        """Roll and pitch of the trunk [rad], numbers of single precision; a level trunk draws nothing."""
        if self.settings.tilt == 0.0:
            return 0.0, 0.0
        roll, pitch = rng.uniform(-self.settings.tilt, self.settings.tilt, 2).astype(np.float32).tolist()
        return roll, pitch

    def flaw(self, heights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Add a sensor's noise and unknown cells, to some maps."""
        s = self.settings
        if rng.random() < s.flawed_share:
            heights = heights + rng.normal(scale=rng.uniform(0, s.noise), size=heights.shape)
        if rng.random() < s.flawed_share:
            missing = rng.random(heights.shape) < rng.uniform(0, s.missing)
            if rng.random() < 0.3:  # a patch that no ray reached
                i, j = rng.integers(0, SIZE, 2)
                missing[i : i + int(rng.integers(2, 10)), j : j + int(rng.integers(2, 10))] = True
            heights = np.where(missing, np.nan, heights)
        return np.asarray(heights, np.float32)


def random_gait(rng: np.random.Generator, speed: float, *, stride: float) -> Gait:
    """A random gait that walks at a speed [m/s].

    The frequency is at least such that the hip travels no further than ``stride`` [m] during a stance: with fewer steps
    the legs would have to stretch beyond their reach on flat ground. The step length fits the speed but for a tenth.
    """
    duty = float(np.float32(rng.uniform(0.45, 0.8)))
    frequency = float(np.float32(max(rng.uniform(0.9, 2.0), duty * speed / stride)))
    swing = (1 - duty) / frequency
    left = 1.2 * swing if rng.random() < 0.5 else rng.uniform(0.1, 1.0) * swing
    length = min(speed / frequency * rng.normal(1.0, 0.1), 1.0)
    return Gait(float(np.float32(max(length, 0.0))), frequency, duty, float(np.float32(left)))
