"""What hangs on a robot besides its legs: arms, tails and heads are held at their pose, their mass stays.

Without a controller of their own they would swing about, and a controller of legs knows nothing of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np


def hold_limbs(spec: mujoco.MjSpec, trunk: str, legs: Sequence[mujoco.MjsJoint]) -> list[str]:
    """Take out every joint that is no leg's: what it moved is fixed as in the file's first keyframe, or as drawn.

    Bodies that do not hang on the trunk, and tendons and equalities of the joints, are taken out too.

    Args:
        spec: the robot's file as it was read.
        trunk: name of the body that the legs hang on; empty if it has none.
        legs: their twelve joints.

    Returns:
        names of the joints taken out; of one without a name, its body's.

    Raises:
        ValueError: MuJoCo cannot compile the file.
    """
    ours = {joint.name for joint in legs}
    strangers = [body for body in spec.worldbody.bodies if body.name != trunk]
    off_robot = {joint.name for body in strangers for below in (body, *body.find_all("body")) for joint in below.joints}
    held = [
        joint
        for joint in spec.joints
        if joint.type != mujoco.mjtJoint.mjJNT_FREE and joint.name not in ours | off_robot
    ]
    if held:
        _fix(spec, held)
    names = [joint.name or joint.parent.name for joint in held]
    for equality in [one for one in spec.equalities if {one.name1, one.name2} & {*names, *off_robot}]:
        spec.delete(equality)
    for tendon in [one for one in spec.tendons if any(_of(wrap) in {*names, *off_robot} for wrap in one.path)]:
        for equality in [one for one in spec.equalities if tendon.name in (one.name1, one.name2)]:
            spec.delete(equality)
        spec.delete(tendon)
    for element in (*held, *strangers):
        spec.delete(element)
    return names


def _of(wrap: mujoco.MjsWrap) -> str:
    return "" if wrap.target is None else str(wrap.target.name)


def _fix(spec: mujoco.MjSpec, joints: Sequence[mujoco.MjsJoint]) -> None:
    """Draw the bodies of joints at the pose at which they are to be held."""
    model = spec.compile()
    data = mujoco.MjData(model)
    if model.nkey:
        for joint in joints:
            first = int(model.jnt_qposadr[joint.id])
            after = np.flatnonzero(model.jnt_qposadr > first)
            last = int(model.jnt_qposadr[after].min()) if len(after) else model.nq
            data.qpos[first:last] = model.key_qpos[0, first:last]
    mujoco.mj_kinematics(model, data)
    places = {}
    for joint in joints:
        body = int(model.jnt_bodyid[joint.id])
        parent = int(model.body_parentid[body])
        position, back, turned = np.zeros(3), np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(back, data.xquat[parent])
        mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[parent], back)
        mujoco.mju_mulQuat(turned, back, data.xquat[body])
        places[body] = joint.parent, position, turned
    for body, position, turned in places.values():
        # Relative to its parent, whatever frames the file drew it in.
        body.set_frame(body.parent.add_frame())
        body.pos, body.quat, body.alt.type = position, turned, mujoco.mjtOrientation.mjORIENTATION_QUAT
