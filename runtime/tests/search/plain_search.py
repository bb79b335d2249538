"""The foothold search once more, in plain Python: rules, costs and A* with a dictionary and no laziness.

It shares definitions with the package (settings, limits of legs, raster of the ground) and no kernel but the robot's
inverse kinematics, whose answers it verifies by forward kinematics.
"""

import heapq
import itertools
import math

import numpy as np

from legtool_runtime.legs import Legs
from legtool_runtime.search.settings import GAITS

MIRROR = np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]])
EPS = 1e-7


class Plain:
    """One problem: a robot, its rules, places to stand on and a ground."""

    def __init__(self, robot, settings, points, prices, ground, trunk, *, height=None):
        self.robot, self.rules, self.feet = robot, settings.walkability, settings.feet
        self.points, self.prices, self.ground, self.trunk = points, prices, ground, trunk
        self.legs = Legs.of(robot)
        self.height = height or robot.standing_height
        self.first = len(points) - 4
        self.start = self.shape(points[self.first :])
        self.fits, self.spans, self.shapes = {}, {}, {}

    # --- what a stance is

    def shape(self, p):
        """Middle, heading, axes, and equation 16's dimensions."""
        ahead = 0.5 * (p[0] + p[1] - p[2] - p[3])
        if np.hypot(*ahead[:2]) < 0.02:
            return None
        x = ahead / np.linalg.norm(ahead)
        left = 0.5 * (p[0] + p[2] - p[1] - p[3])
        left = left - (left @ x) * x
        if np.linalg.norm(left) < 0.02:
            return None
        y = left / np.linalg.norm(left)
        if x[0] * y[1] - x[1] * y[0] < 0:
            y = -y
        middle = p.mean(axis=0)
        return {
            "middle": middle,
            "heading": ahead[:2] / np.hypot(*ahead[:2]),
            "width": [y @ (p[0] - p[1]), y @ (p[2] - p[3])],
            "length": [x @ (p[0] - p[2]), x @ (p[1] - p[3])],
            "skew": [abs(x @ (p[0] - p[1])), abs(x @ (p[2] - p[3]))],
            "twist": abs(p[0, 2] - p[1, 2] - p[2, 2] + p[3, 2]) / 4,
            "slopes": [abs(x[2]), abs(y[2])],
            "hips": np.abs((p - middle) @ x - self.legs.hips[:, 0]),
        }

    def shape_of(self, state):
        """The shape of a stance, remembered."""
        if state not in self.shapes:
            self.shapes[state] = self.shape(self.points[list(state)])
        return self.shapes[state]

    def pose(self, feet, weights=(1, 1, 1, 1)):
        """Position and rotation of the base over feet's centres (4, 3): 0.8 of the plane's slope, as tracked."""
        w = np.asarray(weights, float)
        ahead = feet[0] + feet[1] - feet[2] - feet[3]
        yaw = math.atan2(ahead[1], ahead[0])
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        middle = feet.mean(axis=0)
        flat = (feet[:, :2] - middle[:2]) @ turn.T
        slope, *_ = np.linalg.lstsq(flat, feet[:, 2] - middle[2], rcond=None)
        place = (w[:, None] * feet[:, :2]).sum(axis=0) / w.sum()
        off = turn @ (place - middle[:2])
        z = middle[2] + self.height - self.robot.foot_radius + 0.8 * slope @ off
        roll, pitch = 0.8 * math.atan(slope[1]), -0.8 * math.atan(slope[0])
        return np.array([*place, z]), _rotation(roll, pitch, yaw)

    def reaches(self, feet, standing, weights=(1, 1, 1, 1)):
        """The pose at which legs reach, lowered at most thrice where one is too short; None if there is none."""
        position, rotation = self.pose(feet, weights)
        for _ in range(4):
            faults = [self._leg(leg, rotation.T @ (feet[leg] - position)) for leg in range(4) if standing[leg]]
            first = next((f for f in faults if f), 0)
            if first == 0:
                return position, rotation
            if first == 2:
                return None
            position = position - [0, 0, 0.05 * self.legs.size]
        return None

    def _leg(self, leg, foot):
        hip = foot - self.legs.hips[leg]
        if hip[2] > -0.15 * self.legs.size:
            return 2
        span = math.sqrt(hip[0] ** 2 + max(hip[1] ** 2 + hip[2] ** 2 - self.legs.offset[leg] ** 2, 1e-8))
        if span > self.legs.longest[leg]:
            return 1
        if span < self.legs.shortest[leg]:
            return 2
        feet = np.tile(foot, (4, 1))
        joints, reached = self.robot.joints(feet)
        if not reached[leg]:
            return 2
        assert np.abs(self.robot.feet(joints)[leg] - foot).max() < 1e-6
        for angle, (low, high) in zip(joints[leg], self.robot.joint_limits[leg], strict=True):
            middle = 0.5 * (low + high)
            near = middle + math.remainder(angle - middle, 2 * math.pi)
            if not low + 0.05 <= near <= high - 0.05:
                return 2
        return 0

    # --- which are valid

    def stands(self, state):
        """Whether a stance's legs and trunk are free; remembered."""
        if state not in self.fits:
            self.fits[state] = self._stands(self.points[list(state)])
        return self.fits[state]

    def _stands(self, p):
        r = self.rules
        feet = p + np.array([0, 0, self.robot.foot_radius])
        position, rotation = self.pose(feet)
        if r.inverse_kinematics:
            found = self.reaches(feet, [True] * 4)
            if found is None:
                return False
            position, rotation = found
            if r.shank >= 0 and not self._shanks(feet, position, rotation, r.shank):
                return False
        if r.trunk >= 0:
            hips = self.robot.hips[:, 0]
            half, belly = 0.45 * (hips.max() - hips.min()), 0.16 * self.legs.size
            yaw = math.atan2(rotation[1, 0], rotation[0, 0])
            for along in np.linspace(-half, half, 5):
                x, y = position[0] + math.cos(yaw) * along, position[1] + math.sin(yaw) * along
                if position[2] - belly < _height(self.trunk, x, y) + r.trunk:
                    return False
        return True

    def _shanks(self, feet, position, rotation, clearance):
        for leg in range(4):
            inside = rotation.T @ (feet[leg] - position)
            joints, _ = self.robot.joints(np.tile(inside, (4, 1)))
            hip, thigh, _ = joints[leg]
            offset, length = self.robot.abduction_offset[leg], self.robot.thigh_length[leg]
            knee = self.robot.hips[leg] + _rotation(hip, 0, 0) @ (
                np.array([0, offset, 0]) + _rotation(0, thigh, 0) @ [0, 0, -length]
            )
            for share in (0.2, 0.4, 0.6, 0.8, 1.0):
                point = position + rotation @ (inside + share * (knee - inside))
                if _under(self.ground, point[0], point[1], clearance, ball=True) > point[2]:
                    return False
        return True

    def shape_fault(self, shape, state, single):
        """Which limit of a stance's shape is broken; what feet of the start broke there is waived."""
        r, old, s = self.rules, [k >= self.first for k in state], self.start

        def off(value, ideal, most):
            return abs((value if r.signed else abs(value)) - ideal) - most

        checks = []
        for k in range(2):
            w = (r.width, r.width_off)
            checks.append(("width", off(shape["width"][k], *w), off(s["width"][k], *w), old[2 * k] or old[2 * k + 1]))
            w = (r.length, r.length_off)
            checks.append(("length", off(shape["length"][k], *w), off(s["length"][k], *w), old[k] or old[k + 2]))
            checks.append(("skew", shape["skew"][k] - r.skew, s["skew"][k] - r.skew, old[2 * k] or old[2 * k + 1]))
            checks.append(("tilt", shape["slopes"][k] - math.sin(min(r.tilt, math.pi / 2)), 0, False))
        checks.append(("uneven", shape["twist"] - r.uneven, s["twist"] - r.uneven, any(old)))
        most = r.hip_offset_walk if single else r.hip_offset
        for leg in range(4):
            checks.append(("hip", shape["hips"][leg] - most, s["hips"][leg] - most, any(old)))
        for name, value, at_start, waived in checks:
            if value > 1e-9 and not (waived and value <= at_start + 0.01):
                return name
        return ""

    def fault(self, a, b, swings):
        """Which rule the transition between two stances (candidates of the four feet) breaks; empty if none."""
        r, p, q = self.rules, self.points[list(a)], self.points[list(b)]
        moved = [leg for leg in range(4) if a[leg] != b[leg]]
        if not set(moved) <= set(swings):
            return "sequence"
        single = len(swings) == 1
        if moved and not single and self.off_line(p, q, swings) > self._line_limit(p, a, swings) + EPS:
            return "line"
        shape, before = self.shape_of(b), self.shape_of(a)
        if shape is None:
            return "plane"
        if not moved:
            return ""
        position, rotation = self.spans.setdefault(a, self._old_pose(p))
        for leg in moved:
            way = q[leg] - p[leg]
            if np.linalg.norm(way) > r.swing + EPS or not -r.swing_down - EPS <= way[2] <= r.swing_up + EPS:
                return "swing"
            inside = rotation.T @ (q[leg] - position)
            share = np.abs(inside - np.array(r.centre) * MIRROR[leg]) / r.semi_axes
            if (share**r.exponent).sum() > 1 or share.max() > 1:
                return "reach"
            for other in range(4):
                if other != leg and np.linalg.norm(q[leg] - q[other]) < r.apart - EPS:
                    return "apart"
        if name := self.shape_fault(shape, b, single):
            return name
        turned = math.atan2(
            before["heading"][0] * shape["heading"][1] - before["heading"][1] * shape["heading"][0],
            before["heading"] @ shape["heading"],
        )
        if r.turn < 1.5 and abs(turned) > r.turn + 1e-6:
            return "turn"
        if single and r.support > 0 and not self._supported(p, q, swings[0]):
            return "support"
        if r.inverse_kinematics and not self._reaches_between(a, p, q, moved):
            return "kinematics"
        if math.isfinite(r.apex) and not all(self._clears(p[leg], q[leg]) for leg in moved):
            return "corridor"
        return "" if self.stands(b) else "stance"

    def _old_pose(self, p):
        feet = p + np.array([0, 0, self.robot.foot_radius])
        position, rotation = self.pose(feet)
        return np.array([*position[:2], p[:, 2].mean() + self.height]), rotation

    def off_line(self, p, q, swings):
        """δ: distance of the torso half-way from the line through the two feet that bear."""
        a, b = (leg for leg in range(4) if leg not in swings)
        way = p[b, :2] - p[a, :2]
        normal = np.array([-way[1], way[0]]) / np.hypot(*way)
        middle = 0.5 * (p[:, :2].mean(axis=0) + q[:, :2].mean(axis=0))
        return abs(normal @ (middle - p[a, :2]))

    def _line_limit(self, p, a, swings):
        bearing = [a[leg] for leg in range(4) if leg not in swings]
        r = self.rules
        return max(r.off_line, self.off_line(p, p, swings)) if any(k >= self.first for k in bearing) else r.off_line

    def _supported(self, p, q, swings):
        others = [leg for leg in range(4) if leg != swings]
        for foot in (p[swings], q[swings]):
            com = (sum(p[leg, :2] for leg in others) + 0.2 * foot[:2]) / 3.2
            corners = np.array([[*p[leg, :2], 1.0] for leg in others]).T
            if abs(np.linalg.det(corners)) < 2 * 0.005:
                return False
            if np.linalg.solve(corners, [*com, 1.0]).min() < self.rules.support:
                return False
        return True

    def _reaches_between(self, a, p, q, moved):
        radius = [0, 0, self.robot.foot_radius]
        if len(moved) > 1:
            standing = [leg not in moved for leg in range(4)]
            return self.reaches(0.5 * (p + q) + radius, standing) is not None
        weights = np.where(np.arange(4) == moved[0], 0.2, 1.0)
        begins = min(a) >= self.first or self.reaches(p + radius, [True] * 4, weights) is not None
        return begins and self.reaches(q + radius, [True] * 4, weights) is not None

    def _clears(self, a, b):
        end, apex = max(a[2], b[2]), self.rules.apex
        length = np.hypot(*(b - a)[:2])
        many = math.ceil(np.hypot(*(b - a)[:2]) / (2 * self.ground.cell))
        radius = self.robot.foot_radius + 0.02
        for share in np.arange(many + 1) / max(many, 1):
            x, y = (a + share * (b - a))[:2]
            most = end + apex - 0.03
            for foot, far in ((a, share * length), (b, (1 - share) * length)):
                if far <= 0.16 * apex:
                    most = min(most, end + 0.2 * apex, foot[2] + 0.6 * apex)
            if _under(self.ground, x, y, radius) > most:
                return False
        return True

    def cost(self, a, b, swings):
        """Of a transition that is valid, section VI-C3 and what was added to it."""
        r, p, q = self.rules, self.points[list(a)], self.points[list(b)]
        before, shape, single = self.shape_of(a), self.shape_of(b), len(swings) == 1
        cos = float(np.clip(before["heading"] @ shape["heading"], -1, 1))
        total = np.linalg.norm(shape["middle"] - before["middle"]) + r.turn_m * math.acos(cos) + r.per_step_m
        for k in range(2):
            total += r.shape_m * ((shape["width"][k] - r.width) / r.width_off) ** 2
            total += r.shape_m * ((shape["length"][k] - r.length) / r.length_off) ** 2
        if r.hip_m > 0:
            most = r.hip_offset_walk if single else r.hip_offset
            total += 0.25 * r.hip_m * ((shape["hips"] / most) ** 2).sum()
        moved = [leg for leg in swings if a[leg] != b[leg]]
        for leg in moved:
            total += self.prices[b[leg]] + 0.25 * r.climb_m * abs(q[leg, 2] - p[leg, 2])
        if moved and not single and math.isfinite(r.off_line) and r.off_line > 0:
            total += r.off_line_m * min(self.off_line(p, q, swings) / r.off_line, 1) ** 2
        return float(total)

    # --- the search

    def search(self, gait, phase, goal, tolerance, yaw=None, yaw_tolerance=math.pi / 4, most=10**9):
        """Cost and stances of the cheapest path to a torso place (3,), or None."""
        phases, begin = GAITS[gait], tuple(range(self.first, self.first + 4))

        def left(state):
            place = self.points[list(state)].mean(axis=0) + np.array([0, 0, self.height])
            return max(np.linalg.norm(place - goal) - tolerance, 0)

        open_, best, parents, closed = [(left(begin), 0.0, begin, phase)], {(begin, phase): 0.0}, {}, set()
        while open_ and len(closed) < most:
            _, g, state, k = heapq.heappop(open_)
            if (state, k) in closed:
                continue
            closed.add((state, k))
            if k == phase and self._arrived(state, goal, tolerance, yaw, yaw_tolerance):
                path = [(state, k)]
                while path[-1] in parents:
                    path.append(parents[path[-1]])
                return g, [s for s, _ in path[::-1]]
            for swings in phases[k]:
                own = [[state[leg], *range(self.first)] for leg in swings]
                for choice in itertools.product(*own):
                    after = list(state)
                    for leg, c in zip(swings, choice, strict=True):
                        after[leg] = c
                    after, following = tuple(after), (k + 1) % len(phases)
                    if (after, following) in closed or self.fault(state, after, swings):
                        continue
                    cost = g + self.cost(state, after, swings)
                    if cost < best.get((after, following), math.inf) - 1e-12:
                        best[after, following] = cost
                        parents[after, following] = (state, k)
                        heapq.heappush(open_, (cost + left(after), cost, after, following))
        return None

    def _arrived(self, state, goal, tolerance, yaw, yaw_tolerance):
        p = self.points[list(state)]
        place = p.mean(axis=0) + np.array([0, 0, self.height])
        if np.linalg.norm(place - goal) > tolerance:
            return False
        heading = self.shape(p)["heading"]
        return (
            yaw is None or abs(math.remainder(math.atan2(heading[1], heading[0]) - yaw, 2 * math.pi)) <= yaw_tolerance
        )


def _rotation(roll, pitch, yaw):
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )


def _height(ground, x, y):
    i, j = math.floor((x - ground.low_x) / ground.cell), math.floor((y - ground.low_y) / ground.cell)
    inside = 0 <= i < ground.heights.shape[0] and 0 <= j < ground.heights.shape[1]
    return float(ground.heights[i, j]) if inside else math.nan


def _under(ground, x, y, radius, *, ball=False):
    """Height of a disc's centre, or a ball's, that lies on the highest cells that it touches; -inf over unknown."""
    cell, best = ground.cell, -math.inf
    for i in range(math.floor((x - radius - ground.low_x) / cell), math.floor((x + radius - ground.low_x) / cell) + 1):
        for j in range(
            math.floor((y - radius - ground.low_y) / cell), math.floor((y + radius - ground.low_y) / cell) + 1
        ):
            if not (0 <= i < ground.heights.shape[0] and 0 <= j < ground.heights.shape[1]):
                continue
            left, below = ground.low_x + i * cell, ground.low_y + j * cell
            dx, dy = max(left - x, 0, x - left - cell), max(below - y, 0, y - below - cell)
            deep = radius * radius - dx * dx - dy * dy
            if deep >= 0:
                best = np.fmax(best, float(ground.heights[i, j]) + (math.sqrt(deep) if ball else 0.0))
    return best
