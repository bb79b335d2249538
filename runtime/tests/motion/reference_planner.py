"""Algorithm 1 of the motion paper in plain Python, to check the compiled search against."""

import heapq
import math
from statistics import NormalDist

import numpy as np

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
    confidence = planner.settings.confidence
    quantile = 0.0 if confidence is None else NormalDist().inv_cdf(confidence)
    found = []
    margin = planner.settings.margin_m
    attempts = [(margin, 1.0, 40, 50), (margin, 0.5, 40, 50)] if quantile > 0 else []
    for margin_m, part, insist, most in [*attempts, (margin, 0.0, 150, 150), *([(0.0, 0.0, 40, 50)] if margin else [])]:
        halts = any(plan[0] == "halted" for plan in found)
        if margin_m < margin and halts and state.previous_reference.any():
            break
        at = (position, rotation, goal)
        status, node, blocked, made = search(planner, state, costmap, *at, margin_m, part * quantile, insist, most)
        result = (status, *trace(node), blocked, made)
        if margin_m < margin:
            if status in ("goal", "horizon") or (status == "halted" and not halts):
                return ("horizon" if status == "halted" else status, *result[1:])
            break
        found.append(result)
        if status in ("goal", "horizon"):
            return result
    halting = next((("horizon", *plan[1:]) for plan in found if plan[0] == "halted"), None)
    if halting is not None or found[-1][0] != "deadline":
        return halting or found[-1]
    return ("deadline", *max(found, key=lambda plan: len(plan[1]))[1:3], None, found[-1][4])


def search(planner, state, costmap, position, rotation, goal, margin_m, quantile, insist, most):
    s, model, commands = planner.settings, planner.model, planner.commands
    speeds = np.hypot(commands[:, 0], commands[:, 1])
    fastest = math.inf
    if goal.max_speed is not None and (speeds >= goal.max_speed - 1e-9).any():
        fastest = speeds[speeds >= goal.max_speed - 1e-9].min() + 1e-9
    heading0 = math.atan2(rotation[1, 0], rotation[0, 0])
    start = Node(
        position=np.array(position, float), yaw=0.0, velocity=state.velocity, previous_velocity=state.previous_velocity,
        reference=state.previous_reference, feet=position + state.feet_base @ rotation.T, depth=0, waited=0, cost=0.0,
        parent=None, command=None,
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
    made, best, halted, expanded = 1, start, None, 0
    heap, open_nodes, visited = [(0.0, 0, start, None)], {}, set()  # O, by age among equals, and V
    rejected = np.zeros((s.horizon + 1, 4), int)
    while heap:
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
        if expanded >= most:
            return ("halted", halted, None, made) if halted else ("deadline", best, None, made)
        expanded += 1
        pair = (state.swing_pair + node.depth) % 2
        c, si = math.cos(node.yaw), math.sin(node.yaw)
        turned = np.array([[c, -si, 0], [si, c, 0], [0, 0, 1]]) @ rotation
        change = np.hypot(*(commands[:, :2] - node.reference[:2]).T)
        slow = speeds <= fastest
        allowed = np.flatnonzero(slow & (change <= s.max_velocity_change + 1e-9))
        if len(allowed) == 0:
            allowed = np.array([np.flatnonzero(slow)[np.argmin(change[slow])]])
        feet_base = (node.feet - node.position) @ turned
        fixed = np.concatenate([node.velocity, node.previous_velocity, np.zeros(3), node.reference, feet_base.ravel()])
        features = np.tile(fixed, (len(allowed), 1))
        features[:, 6:9] = commands[allowed]
        fdm, cdm, cvm, scale = predict(model, features, pair)
        legs = list(TROT_PAIRS[pair])
        landing = node.feet[legs] + fdm.reshape(-1, 2, 3) @ turned.T
        distances = costmap.distance_at(landing.reshape(-1, 3)).reshape(-1, 2).astype(float)
        margin = margin_m + quantile * np.sqrt(planner._spread[node.depth] + (scale[:, None] - 1) * planner._noise)
        bad = distances - costmap.resolution_m / 2 < margin
        rejected[node.depth, legs] += bad.sum(axis=0)
        for row in np.flatnonzero(~bad.any(axis=1)):
            index, distance = int(allowed[row]), distances[row].tolist()
            feet = node.feet.copy()
            feet[legs] = landing[row]
            com = node.position + turned @ cdm[row, :3]
            yaw = node.yaw + cdm[row, 3]
            stands = not commands[index].any()
            left = remaining(Node(position=com, yaw=yaw))
            waited = node.waited + (stands and left > near)
            cost = left + sum(s.d_max_m - d for d in distance if d < s.d_max_m) + s.waiting_cost_m * waited
            child_key = (
                index, math.floor(com[0] / s.cell_m), math.floor(com[1] / s.cell_m),
                math.floor(yaw / s.heading_bin_rad + 0.5), 1 - pair, node.depth + 1 if stands else 0,
            )  # fmt: skip
            if child_key in visited:
                continue
            if child_key in open_nodes and cost >= open_nodes[child_key].cost:
                continue
            child = Node(
                position=com, yaw=yaw, velocity=cvm[row], previous_velocity=node.velocity, reference=commands[index],
                feet=feet, depth=node.depth + 1, waited=waited, cost=cost, parent=node, command=commands[index],
            )  # fmt: skip
            open_nodes[child_key] = child
            heapq.heappush(heap, (cost, made, child, child_key))
            made += 1
            if child.depth > best.depth or (child.depth == best.depth and cost < best.cost):
                best = child
    if halted:
        return "halted", halted, None, made
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
