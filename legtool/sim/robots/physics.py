"""The world a robot walks in: solver options, floor, and the contact rules that terrain shares with it."""

from __future__ import annotations

import logging

import mujoco

from legtool.configs.sweep import CONTROL_RATE_HZ

#: Physics steps in a control tick, and their length [s].
SUBSTEPS = 2
PHYSICS_STEP_S = 1.0 / (SUBSTEPS * CONTROL_RATE_HZ)

#: Terrain touches robots, robots do not touch themselves: a trot's legs never meet, and looking for it costs time.
#: Of two geoms that touch, MuJoCo takes the friction and softness of that with the higher priority: the ground.
TERRAIN_CONTACT = {"contype": 1, "conaffinity": 2, "priority": 1}
ROBOT_CONTACT = {"contype": 2, "conaffinity": 1, "priority": 0}

#: MuJoCo's warnings go here, instead of to the console and a file in the working directory.
log = logging.getLogger("legtool.mujoco")
log.addHandler(logging.NullHandler())
mujoco.set_mju_user_warning(log.warning)

FLOOR_FRICTION = (0.8, 0.005, 0.0001)


def empty_world() -> mujoco.MjSpec:
    """A world without anything in it, with the solver options every simulation here uses."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    set_options(spec)
    return spec


def flat_world(friction: float = FLOOR_FRICTION[0]) -> mujoco.MjSpec:
    """A flat, endless floor at z = 0."""
    spec = empty_world()
    add_floor(spec, friction)
    return spec


def add_floor(spec: mujoco.MjSpec, friction: float = FLOOR_FRICTION[0]) -> None:
    """Add an endless floor at z = 0."""
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        friction=[friction, *FLOOR_FRICTION[1:]],
        **TERRAIN_CONTACT,
    )


def set_options(spec: mujoco.MjSpec) -> None:
    """Step, integrator and contact model. Elliptic cones and impratio keep stance feet from creeping."""
    spec.option.timestep = PHYSICS_STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    spec.option.iterations = 30
