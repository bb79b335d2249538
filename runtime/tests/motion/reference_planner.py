"""Algorithm 1 of the motion paper in plain Python, to check the compiled search against."""

import heapq
import math

import numpy as np
import walker
from scipy.stats import norm as NORMAL

from legtool_runtime.motion.features import FEATURE_SIGN, FEATURE_SWAP, TARGET_SIGN, TARGETS, as_on_level_ground
from legtool_runtime.motion.kernels import design
from legtool_runtime.motion.model import MotionState
from legtool_runtime.robot import LEGS, TROT_PAIRS


class Node:
    def __init__(self, **values):
        self.__dict__.update(values)


def predict(model, features, pair):
    """Rows of the 24 inputs to displacement of the swing feet, of the CoM, next velocity, and the FDM's scale."""
    x = features[:, FEATURE_SWAP] * FEATURE_SIGN if pair == 1 else features
    phi = design(x, model.degree)
    out = []
    for name in TARGETS:
        weights = np.column_stack([model.parameters[f"{name}.intercept"], model.parameters[f"{name}.coefficients"]])
        y = phi @ weights.T
        out.append(y * TARGET_SIGN[name] if pair == 1 else y)
    scale = 1 + ((phi @ model.parameters["fdm.weights_covariance"]) * phi).sum(axis=1)
    return (*out, scale)


def plan(planner, state, costmap, *, position, rotation, goal):
    """What Planner.plan is to return, without a deadline: status, commands, costs, blocked leg, nodes made."""
    feet, level = as_on_level_ground(state.feet_base[None], rotation[None])
    rotation = level[0]
    state = MotionState(state.velocity, state.previous_velocity, state.previous_reference, feet[0], state.swing_pair)
    status, node, blocked, made = search(planner, state, costmap, position, rotation, goal)
    return ("horizon" if status == "halted" else status, *trace(node), blocked, made)


def search(planner, state, costmap, position, rotation, goal, insist=100, breadth=20):
    s, model, commands = planner.settings, planner.model, planner.commands
    speeds = np.hypot(commands[:, 0], commands[:, 1])
    fastest = math.inf
    if goal.max_speed is not None and (speeds >= goal.max_speed - 1e-9).any():
        fastest = speeds[speeds >= goal.max_speed - 1e-9].min() + 1e-9
    heading0 = math.atan2(rotation[1, 0], rotation[0, 0])
    start = Node(
        position=np.array(position, float), yaw=0.0, velocity=state.velocity, previous_velocity=state.previous_velocity,
        reference=state.previous_reference, feet=position + state.feet_base @ rotation.T, depth=0, waited=0, risk=0.0,
        cost=0.0, parent=None, command=None,
    )  # fmt: skip

    def distance_left(node):
        return math.hypot(goal.x - node.position[0], goal.y - node.position[1])

    def heading_error(node):
        wanted = goal.heading
        if wanted is None:
            if not commands[:, 2].any() or distance_left(node) <= near:
                return 0.0
            wanted = math.atan2(goal.y - node.position[1], goal.x - node.position[0])
        return abs(wrap(wanted - heading0 - node.yaw))

    def remaining(node):
        return distance_left(node) + s.heading_weight_m_per_rad * heading_error(node)

    near = s.goal_tolerance_m + 0.2
    headway = 0.05 if goal.max_speed is None else min(0.05, 0.1 * goal.max_speed)
    made, best, halted, expanded, cut, at_depth = 1, start, None, 0, False, [0] * s.horizon
    heap, open_nodes, visited = [(0.0, 0, start, None)], {}, set()  # O, by age among equals, and V
    rejected = np.zeros((s.horizon + 1, 4), int)
    bound = s.max_velocity_change
    while heap or (made == 1 and bound < math.inf):
        if not heap:  # no first step is safe
            heap, bound, at_depth[0] = [(0.0, 0, start, None)], math.inf, 0
        _, _, node, key = heapq.heappop(heap)
        if key is not None:
            if open_nodes.get(key) is not node:
                continue
            del open_nodes[key]
            visited.add(key)
        if distance_left(node) <= s.goal_tolerance_m and heading_error(node) <= s.heading_tolerance_rad:
            return "goal", node, None, made
        if node.depth == s.horizon:
            progress = remaining(node.parent) - remaining(node), remaining(start) - remaining(node)
            if any(remaining(n) <= near for n in chain(node)):
                return "horizon", node, None, made
            if progress[0] >= headway and progress[1] >= headway * s.horizon:
                return "horizon", node, None, made
            if not halted:
                halted, more = node, expanded + insist
            if expanded >= more:
                return "halted", halted, None, made
            continue
        if halted and expanded >= more:
            return "halted", halted, None, made
        if at_depth[node.depth] >= breadth:
            cut = True
            continue
        at_depth[node.depth] += 1
        expanded += 1
        pair = (state.swing_pair + node.depth) % 2
        c, si = math.cos(node.yaw), math.sin(node.yaw)
        turned = np.array([[c, -si, 0], [si, c, 0], [0, 0, 1]]) @ rotation
        change = np.hypot(*(commands[:, :2] - node.reference[:2]).T)
        slow = speeds <= fastest
        allowed = np.flatnonzero(slow & (change <= (s.max_velocity_change if node.parent else bound) + 1e-9))
        if len(allowed) == 0:
            allowed = np.array([np.flatnonzero(slow)[np.argmin(change[slow])]])
        feet_base = (node.feet - node.position) @ turned
        fixed = np.concatenate([node.velocity, node.previous_velocity, np.zeros(3), node.reference, feet_base.ravel()])
        features = np.tile(fixed, (len(allowed), 1))
        features[:, 6:9] = commands[allowed]
        fdm, cdm, cvm, scale = predict(model, features, pair)
        legs = list(TROT_PAIRS[pair])
        landing = node.feet[legs] + fdm.reshape(-1, 2, 3) @ turned.T
        com = node.position + cdm[:, :3] @ turned.T
        roll = (com - node.position)[:, :2] * (walker.ROBOT.foot_radius / walker.ROBOT.standing_height)
        rolled = landing[:, :, :2] + roll[:, None]
        landed = costmap.distance_at(landing.reshape(-1, 3)).reshape(-1, 2).astype(float)
        distances = np.minimum(landed, costmap.distance_at(rolled.reshape(-1, 2)).reshape(-1, 2))
        spare = distances - costmap.resolution_m / 2 - s.margin_m
        spread = planner._models.spread[node.depth]
        std = np.sqrt(spread + (scale[:, None] - 1) * planner._models.noise)
        misstep = np.where((spare < 4 * np.sqrt(spread)) & (s.misstep_cost_m > 0), NORMAL.sf(spare / std), 0.0)
        bad = (landed - costmap.resolution_m / 2 if s.misstep_cost_m else spare) < 0
        rejected[node.depth, legs] += bad.sum(axis=0)
        for row in np.flatnonzero(~bad.any(axis=1)):
            index, distance = int(allowed[row]), distances[row].tolist()
            feet = node.feet.copy()
            feet[:, :2] += roll[row]
            feet[legs] = landing[row]
            yaw = node.yaw + cdm[row, 3]
            stands = not commands[index].any()
            left = remaining(Node(position=com[row], yaw=yaw))
            waited = node.waited + (stands and left > near)
            cost = left + sum(s.d_max_m - d for d in distance if d < s.d_max_m)
            risk = node.risk
            for probability in misstep[row].tolist():
                risk += s.misstep_cost_m * probability
            cost = cost + s.waiting_cost_m * waited + risk
            child_key = (
                index, math.floor(com[row, 0] / s.cell_m), math.floor(com[row, 1] / s.cell_m),
                math.floor(yaw / s.heading_bin_rad + 0.5), 1 - pair, node.depth + 1 if stands else 0,
            )  # fmt: skip
            if child_key in visited:
                continue
            if child_key in open_nodes and cost >= open_nodes[child_key].cost:
                continue
            child = Node(
                position=com[row], yaw=yaw, velocity=cvm[row], previous_velocity=node.velocity, feet=feet,
                reference=commands[index], command=commands[index], depth=node.depth + 1, waited=waited, risk=risk,
                cost=cost, parent=node,
            )  # fmt: skip
            open_nodes[child_key] = child
            heapq.heappush(heap, (cost, made, child, child_key))
            made += 1
            if child.depth > best.depth or (child.depth == best.depth and cost < best.cost):
                best = child
    if halted:
        return "halted", halted, None, made
    if cut:
        return "deadline", best, None, made
    worst = rejected[best.depth]
    return "blocked", best, LEGS[worst.argmax()] if worst.any() else None, made


def trace(node):
    path = chain(node)
    return np.array([n.command for n in path]).reshape(-1, 3), np.array([n.cost for n in path])


def chain(node):
    """The nodes of a sequence in order, without the start."""
    return [] if node.parent is None else [*chain(node.parent), node]


def wrap(angle):
    return angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))
