from dataclasses import replace

import numpy as np
import pytest
import torch

from legtool.configs.footholds import FootholdSettings
from legtool.configs.robots import load_robot
from legtool.models.cues import CUES, Cues
from legtool.sim.worlds.foothold_samples import foothold_samples
from legtool.training.foothold import encode_examples
from legtool_runtime.foothold import Criteria
from legtool_runtime.foothold.criteria.judge import FC, KF, LC, MARGIN, TR, UNKNOWN


@pytest.fixture(scope="module", params=["hyq", "aliengo"])
def case(request):
    """Two hundred maps around footholds: what is told of all cells, and why the criteria refuse some."""
    criteria = Criteria(load_robot(request.param).geometry())
    settings = FootholdSettings(robot=request.param, vpa_share=0.0, flawed_share=0.5)
    samples = foothold_samples(settings, 3, criteria).take(slice(0, 1000, 5))
    examples = encode_examples(criteria, samples, "dense")
    heights, vector = torch.from_numpy(examples.heights.astype(np.float32)), torch.from_numpy(examples.vector)
    cues = Cues(criteria.robot, criteria.settings)
    right = samples.leg % 2 == 1
    reasons = samples.reasons.copy()
    reasons[right] = reasons[right][:, :, ::-1]
    return cues, heights, vector, cues(heights, vector), reasons


def agreement(said, reasons, criterion, among=UNKNOWN):
    """Share of cells, those with a bit of ``among`` left out, of which a cue says what the criterion does."""
    return (said == ((reasons & criterion) == 0))[(reasons & among) == 0].mean()


def maps(cells):
    return cells.reshape(-1, 33, 33).numpy()


def test_roughness_is_exact(case):
    _, _, _, told, reasons = case
    assert agreement(told.smooth.numpy(), reasons, TR) > 0.9999


def test_reach_and_joint_limits_agree_with_the_criteria(case):
    _, _, vector, told, reasons = case
    hip = vector[:, :1]
    assert agreement(maps((hip >= told.low) & (hip <= told.high)), reasons, KF) > 0.99


def test_clearances_agree_with_the_criteria_but_for_what_lies_between_samples(case):
    _, _, _, told, reasons = case
    assert agreement(maps(told.clear >= 0), reasons, FC) > 0.99
    leg = maps((told.ankle >= 0) & (told.upper >= 0))
    judged = UNKNOWN | KF | FC | TR
    assert agreement(leg, reasons, LC, judged) > 0.99
    # Instants and points are fewer and others than the criteria's: seldom do they see a collision that those do not.
    assert (leg | ((reasons & LC) > 0))[(reasons & judged) == 0].mean() > 0.99


def test_a_cell_is_told_the_same_among_others_and_alone(case):
    cues, heights, vector, told, _ = case
    cells = torch.tensor([[544, 0, 700]]).expand(len(heights), -1)
    alone = cues(heights, vector, cells)
    assert alone.cues.shape == (len(heights), 3, CUES)
    assert torch.allclose(alone.cues, told.cues[:, [544, 0, 700]], atol=1e-5)


def test_erosion_is_that_of_the_criteria(case):
    cues, _, _, _, reasons = case
    safe = torch.from_numpy((reasons & ~np.uint8(MARGIN) == 0).astype(np.float32))
    assert np.array_equal(cues.erode(safe, outside=0.0).numpy() > 0.5, reasons == 0)


def test_reach_at_other_hip_heights_agrees_with_the_criteria_below_tilted_trunks():
    criteria = Criteria(load_robot("hyq").geometry())
    samples = foothold_samples(FootholdSettings(vpa_share=0.0), 5, criteria).take(slice(0, 1000, 10))
    # Late in the swing, so that the foot lifts off from the same place whatever the hip height.
    samples.gait[:, 3] = 0.2 * (1 - samples.gait[:, 2]) / samples.gait[:, 1]
    tilted = np.maximum(np.abs(samples.roll), np.abs(samples.pitch)) > 0.15
    samples = samples.take(tilted)
    examples = encode_examples(criteria, samples, "dense")
    told = Cues(criteria.robot, criteria.settings)(
        torch.from_numpy(examples.heights.astype(np.float32)), torch.from_numpy(examples.vector)
    )
    same = []
    for shift in (-0.08, 0.08):
        hip = torch.from_numpy(examples.vector[:, :1]) + shift
        reached = maps((hip >= told.low) & (hip <= told.high))
        for n, t in enumerate(samples.tuples()):
            other = replace(t, hip_height=t.hip_height + shift)
            if other.hip_height > other.ground:
                found = criteria.evaluate(other)
                said = reached[n, :, ::-1] if t.leg % 2 == 1 else reached[n]
                same.append((said == found.mask(KF))[(found.reasons & UNKNOWN) == 0].mean())
    assert len(same) > 100 and np.mean(same) > 0.99
