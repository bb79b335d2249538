"""The verdict on a simulated sweep: whether the robot walked as it was told, and what kept it from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from legtool.verdict import Finding, Verdict, graded

#: From where on a figure is green, and from where on amber: share of episodes with a fall; errors [m/s, rad/s].
_FALLS, _VELOCITY, _TURN = (0.0, 0.05), (0.06, 0.15), (0.1, 0.3)
#: Shapes other than feet that bear less than this share of the load are let be; up to so many are named.
_TOUCHING, _NAMED = 0.01, 4
#: Shares from which on a limit is a likely cause: of the time at a limit of torque or angle, of the load that slides,
#: of the time with a leg that is straight, or without a foot on the ground.
_AT_TORQUE, _AT_ANGLE, _STRAIGHT, _SLIDING, _FLIGHT = 0.02, 0.03, 0.1, 0.1, 0.05


def judge_sweep(manifest: Mapping[str, Any], doubts: Sequence[str] = ()) -> Verdict:
    """Judge a sweep by what its episodes counted and measured (:class:`.WalkQuality`).

    Criteria: the robot never falls (amber: in 5 % of the episodes); once a command was held for a second, the mean
    velocity is 0.06 m/s off it (amber: 0.15 m/s), the yaw rate 0.1 rad/s (amber: 0.3 rad/s); shapes other than feet
    bear less than 1 % of the load, and MuJoCo warns of nothing (both amber otherwise).

    Args:
        manifest: of the dataset: ``counts``, ``measured`` and ``settings``.
        doubts: what is odd about the robot's masses, from :func:`.doubtful_masses`.
    """
    counts, measured, settings = manifest["counts"], manifest.get("measured", {}), manifest["settings"]
    touching = _touching(measured)
    advice = _advice(counts, measured, settings, touching, doubts)
    falls, episodes = round(counts.get("falls", 0)), round(counts["episodes"])
    share = falls / episodes
    text = f"the robot fell in {falls} of {episodes} episodes, expected none"
    findings = [graded(share <= _FALLS[0], share <= _FALLS[1], text, advice)]
    for name, what, unit, (good, fair) in (
        ("velocity_error", "velocity", "m/s", _VELOCITY), ("yaw_rate_error", "yaw rate", "rad/s", _TURN),
    ):  # fmt: skip
        if name not in measured:
            continue
        error = measured[name]
        text = f"its {what} is {error:.3f} {unit} off the command, expected at most {good:g} {unit}"
        repeated = any(finding.advice == advice for finding in findings)
        findings.append(graded(error <= good, error <= fair, text, "likely of the same cause" if repeated else advice))
    if "velocity_error" not in measured:
        text = "its velocity cannot be compared: no command was held for a second without a push or a fall"
        findings.append(Finding("amber", text, "hold commands for longer (hold_s), or see why it fell"))
    if touching:
        text = (
            f"shapes other than its feet touch the ground: {_told(touching, measured)}; expected below 1 % of the load"
        )
        findings.append(Finding("amber", text, _without(touching, settings)))
    warnings = {name: value for name, value in counts.items() if name.startswith("mujoco_")}
    if warnings:
        told = ", ".join(f"{name.removeprefix('mujoco_')} {value:g}" for name, value in warnings.items())
        advice = "see the log (logger legtool.mujoco) for where; look at the model's masses, armatures and gains"
        findings.append(Finding("amber", f"MuJoCo warned: {told}, expected no warning", advice))
    return Verdict(tuple(findings))


def _touching(measured: Mapping[str, float]) -> dict[str, float]:
    """Shares of the load that shapes other than feet bear, the largest first; empty where they hardly touch."""
    loads = {
        name.removeprefix("load."): share
        for name, share in measured.items()
        if name.startswith("load.") and share > 0.0
    }
    return dict(sorted(loads.items(), key=lambda item: -item[1])) if sum(loads.values()) >= _TOUCHING else {}


def _told(touching: Mapping[str, float], measured: Mapping[str, float]) -> str:
    named = [
        f"{name} ({100 * share:.0f} % of the load, {100 * measured.get(f'touching.{name}', 0.0):.0f} % of the time)"
        for name, share in list(touching.items())[:_NAMED]
    ]
    rest = list(touching.values())[_NAMED:]
    return ", ".join(named) + (f", and {len(rest)} more ({100 * sum(rest):.0f} %)" if rest else "")


def _without(touching: Mapping[str, float], settings: Mapping[str, Any]) -> str:
    """What to do about shapes that touch."""
    shanks = [name.removeprefix("shank ").split(" ")[0] for name in touching if name.startswith("shank ")]
    if not shanks or settings.get("mjcf") is None:
        return "raise the trunk or the swing (mjcf_names.standing_height, controller.swing_height), or see why it fell"
    names = ",".join(dict.fromkeys(shanks))
    return f"leave the shanks out of contacts with the ground: --set mjcf_names.no_contact=[{names}]"


def _advice(
    counts: Mapping[str, float], measured: Mapping[str, float], settings: Mapping[str, Any],
    touching: Mapping[str, float], doubts: Sequence[str],
) -> str:  # fmt: skip
    """The likely causes of falls and errors, with what to do, the most certain first."""
    causes = []
    if any(counts.get(f"mujoco_bad{what}") for what in ("qpos", "qvel", "qacc")):
        causes.append("the physics diverged: torques too large for the masses and armatures of the joints")
    if doubts:
        causes.append(f"mass or inertia missing or wrong ({'; '.join(doubts[:2])}): complete the model")
    if touching:
        causes.append(f"shapes other than the feet bear {100 * sum(touching.values()):.0f} % of the load")
    for joint in ("hip", "thigh", "knee"):
        if (share := measured.get(f"at_torque_limit.{joint}", 0.0)) >= _AT_TORQUE:
            causes.append(f"the {joint}s' torque is at its limit for {100 * share:.0f} % of the time")
    for joint in ("hip", "thigh", "knee"):
        if (share := measured.get(f"at_joint_limit.{joint}", 0.0)) >= _AT_ANGLE:
            causes.append(
                f"the {joint}s are at the end of their range for {100 * share:.0f} % of the time (other "
                "mjcf_names.standing_height?)"
            )
    if (share := measured.get("straight", 0.0)) >= _STRAIGHT:
        stand = "stand lower (mjcf_names.standing_height) or walk slower"
        causes.append(f"a leg is straight for {100 * share:.0f} % of the time: {stand}")
    if (share := measured.get("sliding", 0.0)) >= _SLIDING:
        causes.append(f"feet slide under {100 * share:.0f} % of the load: the ground's friction is too low")
    if (share := measured.get("flight", 0.0)) >= _FLIGHT:
        causes.append(f"no foot is on the ground for {100 * share:.0f} % of the time: the gait's duty is too low")
    if causes:
        return "likely because " + ", and because ".join(causes[:3])
    if settings.get("black_box"):
        return "no limit was met: check the controller's gains, scales, order of joints and control rate"
    return "no limit was met: the trot's settings (controller.*, mjcf_names.standing_height) do not fit this robot"
