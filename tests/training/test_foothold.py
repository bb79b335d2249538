import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

from legtool.configs.export import ExportSettings
from legtool.configs.footholds import FootholdEvalSettings, FootholdSettings, FootholdTrainSettings
from legtool.configs.robots import load_robot
from legtool.datasets.foothold.heightmaps import load_footholds
from legtool.errors import BundleError, DatasetError, OutputError, RobotError
from legtool.evaluation.foothold import eval_foothold, predicted_counts, proposals
from legtool.models.foothold import Dense
from legtool.models.foothold_run import load_foothold_run
from legtool.pipeline.footholds import collect_footholds
from legtool.training.export import export_bundle
from legtool.training.foothold import FootholdLearner, encode_examples, train_foothold
from legtool.training.freeze_foothold import random_inputs
from legtool_runtime import load_bundle
from legtool_runtime.bundle import content_sha256
from legtool_runtime.foothold import Criteria, CriteriaSettings, Gait, Tuple
from legtool_runtime.foothold.networks import FootholdNetwork
from legtool_runtime.foothold.pose import PosePlanner
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.onnx_session import OnnxSession

SMALL = {"width": 4, "batch": 64}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("data")
    collect_footholds(FootholdSettings(samples=1000, vpa_share=0.3), path / "train")
    collect_footholds(FootholdSettings(samples=1000, vpa_share=0.3, seed=7), path / "fresh")
    return path


def train(data, out, task="vfa", **changes):
    settings = FootholdTrainSettings(**{**SMALL, "epochs": 2, **changes})
    return list(train_foothold(task, [data / "train"], settings, out))


@pytest.fixture(scope="module")
def runs(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("runs")
    train(data, path / "vfa")
    train(data, path / "vpa", task="vpa")
    train(data, path / "dense", network="dense", batch=128, epochs=1)
    return path


def weights(path):
    return load_foothold_run(path).net.state_dict()


def test_a_training_that_was_interrupted_ends_with_the_same_weights(data, runs, tmp_path, monkeypatch):
    whole = train(data, tmp_path / "whole", epochs=3)
    update, calls = FootholdLearner.update, []

    def die_in_the_second_epoch(self, step):
        calls.append(step)
        if calls.count(1) == 2:
            raise KeyboardInterrupt
        return update(self, step)

    monkeypatch.setattr(FootholdLearner, "update", die_in_the_second_epoch)
    with pytest.raises(KeyboardInterrupt):
        train(data, tmp_path / "broken", epochs=3)
    monkeypatch.undo()
    carried_on = train(data, tmp_path / "broken", epochs=3)
    assert "trained 3 epochs" in whole[-1] and "trained 3 epochs" in carried_on[-1]
    one, other = weights(tmp_path / "whole"), weights(tmp_path / "broken")
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert "finished" in train(data, tmp_path / "broken", epochs=3)[0]
    with pytest.raises(OutputError, match=r"settings\.epochs is 3 there, 4 here"):
        train(data, tmp_path / "broken", epochs=4)


def test_training_lowers_the_loss(runs):
    for name in ("vfa", "vpa"):
        history = load_foothold_run(runs / name).description["history"]
        assert history[-1]["training_loss"] < history[0]["training_loss"]


def test_early_stopping_ends_a_training_that_gains_nothing(data, tmp_path):
    train(data, tmp_path / "run", epochs=50, patience=1, learning_rate=0.1, task="vpa", width=4)
    description = load_foothold_run(tmp_path / "run").description
    assert description["complete"] and len(description["history"]) < 50


def test_right_legs_are_mirrored_to_left_ones(data):
    samples, _ = load_footholds([data / "train"])
    robot = load_robot("hyq").geometry()
    some = samples.take(slice(0, 50))
    encoded = encode_examples(Criteria(robot), some, "vfa")
    for n in range(50):
        best = int(some.optimal[n])
        if best >= 0:
            ix, iy = divmod(best, 33)
            mirrored = ix * 33 + (32 - iy if some.leg[n] % 2 else iy)
            assert encoded.optimal[n] == mirrored
            assert encoded.cells[n].reshape(-1)[mirrored] == 2
        else:
            assert encoded.optimal[n] == 1089


def test_the_dense_network_expects_as_many_footholds_as_its_maps_hold():
    torch.manual_seed(0)
    robot = load_robot("hyq").geometry()
    net = Dense(robot, CriteriaSettings.for_robot(robot), 4)
    hips = torch.tensor([[0.4, 0.5, 0.6]])
    bounds = net.bounds(**random_inputs(2, "dense"))
    counts = net.counts(bounds, hips)
    for k, z in enumerate(hips[0]):
        safe = net.log_safe(bounds, z).exp()
        assert safe.sum(dim=(1, 2)).detach().numpy() == pytest.approx(counts[:, k].detach().numpy(), rel=1e-4)


@pytest.fixture(scope="module")
def bundles(runs, tmp_path_factory):
    path = tmp_path_factory.mktemp("bundles")
    paper = export_bundle([runs / "vfa", runs / "vpa"], path / "paper")
    return {"paper": load_bundle(paper), "dense": load_bundle(export_bundle([runs / "dense"], path / "dense"))}


@pytest.mark.parametrize("kind", ["paper", "dense"])
def test_a_bundles_networks_answer_as_the_trained_ones(data, runs, bundles, kind):
    bundle = bundles[kind]
    assert bundle.lines == ("vfa", "vpa") and f"foothold selection by the {kind} network" in str(bundle)
    samples, _ = load_footholds([data / "fresh"])
    around, below = samples.take(samples.vpa == 0), samples.take(samples.vpa == 1)
    expected = proposals(load_foothold_run(runs / ("vfa" if kind == "paper" else "dense")), around.take(slice(0, 60)))
    for n, t in enumerate(around.take(slice(0, 60)).tuples()):
        cell = bundle.vfa.propose(t)
        assert (-1 if cell is None else cell[0] * 33 + cell[1]) == expected[n]
    counts = predicted_counts(
        load_foothold_run(runs / ("vpa" if kind == "paper" else "dense")), below.take(slice(0, 8))
    )
    for n, t in enumerate(below.take(slice(0, 8)).tuples()):
        got = bundle.vpa.counts([t])
        # The robot's map has another median by half precision, which moves the hip heights.
        assert got[0] == pytest.approx(counts[n], abs=max(0.01 * counts[n].max(), 0.5))


@pytest.mark.parametrize("kind", ["paper", "dense"])
def test_networks_take_and_give_what_the_page_on_bundles_says(bundles, kind, check_manifest):
    bundle = bundles[kind]
    check_manifest(bundle.path)
    glance = {"paper": {"vfa": (33, 33), "vpa": (2, 31)}, "dense": {}}[kind]
    gives = {"paper": {"vfa": (1090,), "vpa": (30,)}, "dense": {"vfa": (33, 33), "vpa": (31,)}}[kind]
    for line in ("vfa", "vpa"):
        session = OnnxSession(bundle.path / f"{line}.onnx", what=line, error=BundleError)
        takes = {"heights": (1, 33, 33), "vector": (29,)} | ({"glance": glance[line]} if glance else {})
        assert {port.name: port.shape[1:] for port in session.inputs} == takes
        probe = {name: np.zeros((2, *shape), np.float32) for name, shape in takes.items()}
        (out,) = session.run(probe, ["out"])
        assert out.shape == (2, *gives[line])


def test_a_bundles_networks_select_footholds_and_plan_poses(bundles):
    bundle = bundles["paper"]
    bundle.warm_up()
    criteria = Criteria(bundle.robot, bundle.vfa.criteria)
    assert FootholdSelector(criteria, method="verified", network=bundle.vfa).method == "verified"
    planner = PosePlanner(criteria, network=bundle.vpa)
    twist, gait = (0.2, 0, 0, 0, 0, 0), Gait()
    flat = [Tuple(np.zeros((33, 33)), leg=leg, base_twist=twist, gait=gait) for leg in [0, 1, 2, 3] * 2]
    weights = bundle.vpa.weights(flat).reshape(2, 4, -1)
    assert np.isfinite(planner.optimise(weights, [0.0, 0.0]).objective)


def test_networks_of_another_robot_are_refused(bundles):
    bundle = bundles["paper"]
    other = Criteria(load_robot("go2").geometry())
    with pytest.raises(RobotError, match=f"foothold selection by .*: made for {bundle.robot.name}, .* for go2"):
        FootholdSelector(other, method="cnn", network=bundle.vfa)
    with pytest.raises(RobotError, match=r"safe footholds .*: made for .*Criteria\(bundle.robot\)"):
        PosePlanner(other, network=bundle.vpa)


def test_a_bundle_holds_one_network_for_each_task(runs, tmp_path):
    with pytest.raises(DatasetError, match="both runs of the vpa line; a bundle holds one of each"):
        export_bundle([runs / "vpa", runs / "dense"], tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


def test_a_run_is_of_all_its_datasets(data, tmp_path):
    """Only the first one was looked at: the same command with another second dataset said that it was finished."""
    for other in ("b", "c"):
        collect_footholds(FootholdSettings(samples=1000, vpa_share=0.3, seed=ord(other)), tmp_path / other)
    settings = FootholdTrainSettings(**SMALL, epochs=1)
    list(train_foothold("vfa", [data / "train", tmp_path / "b"], settings, tmp_path / "run"))
    with pytest.raises(OutputError, match="data_hash"):
        list(train_foothold("vfa", [data / "train", tmp_path / "c"], settings, tmp_path / "run"))


def test_the_card_tells_what_was_measured_and_its_example_runs(data, runs, bundles, tmp_path):
    list(eval_foothold("vfa", runs / "vfa", data / "fresh", FootholdEvalSettings(bootstrap=100), tmp_path / "measured"))
    settings = ExportSettings(results=(tmp_path / "measured" / "results.json",))
    bundle = load_bundle(export_bundle([runs / "vfa"], tmp_path / "bundle", settings))
    assert "vfa.paper.perfect" in bundle.metrics("vfa")
    card = (bundle.path / "CARD.md").read_text()
    assert "| vfa.paper.perfect |" in card and "vfa.paper.leg.FL" not in card
    code = (bundles["paper"].path / "CARD.md").read_text().split("```python\n")[1].split("```")[0]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=bundles["paper"].path.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "foothold" in done.stdout


def test_a_model_of_another_shape_or_none_is_refused(bundles):
    robot = bundles["paper"].robot
    paper, dense = ((bundles[kind].path / "vpa.onnx").read_bytes() for kind in ("paper", "dense"))
    with pytest.raises(BundleError, match=r"takes heights .*; expected heights .*, glance \(n, 33, 33\)"):
        FootholdNetwork(robot, paper, dense=False)
    with pytest.raises(BundleError, match=r"gives \(1, 31\) for a sample, expected 1089 numbers"):
        FootholdNetwork(robot, dense, dense=True)
    with pytest.raises(BundleError, match="not an ONNX model"):
        FootholdNetwork(robot, b"no", dense=False)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [("criteria", "slope", 1.0), ("glances", 1, [3, 5, 2])],
)
def test_networks_that_learned_from_another_runtime_are_refused(bundles, tmp_path, name, key, value):
    path = tmp_path / "bundle"
    shutil.copytree(bundles["paper"].path, path)
    manifest = json.loads((path / "bundle.json").read_text())
    manifest["lines"]["vfa"][name][key] = value
    manifest["content_sha256"] = content_sha256(manifest)
    (path / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=f"vfa line: its {name} are not this runtime's"):
        load_bundle(path)


def test_a_bundle_or_run_of_before_the_attitude_is_told_to_be_made_anew(runs, bundles, tmp_path):
    path, run = tmp_path / "bundle", tmp_path / "run"
    shutil.copytree(bundles["paper"].path, path)
    manifest = json.loads((path / "bundle.json").read_text())
    before = [name for name in manifest["lines"]["vfa"]["features"] if name not in ("roll", "pitch")]
    assert len(before) == 27
    manifest["lines"]["vfa"]["features"] = before
    manifest["content_sha256"] = content_sha256(manifest)
    (path / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="vfa line: its network does not know the trunk's roll and pitch; train it"):
        load_bundle(path)
    shutil.copytree(runs / "vfa", run)
    description = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**description, "preparation": before}))
    with pytest.raises(DatasetError, match="hold the trunk's roll and pitch; collect footholds and train it anew"):
        load_foothold_run(run)


def test_evaluation_writes_the_papers_measures_with_intervals(data, runs, tmp_path):
    settings = FootholdEvalSettings(bootstrap=100)
    for name, expected in (  # the dense one is measured at both tasks
        ("vfa", ["vfa.paper.perfect", "vfa.paper.safe", "vfa.paper.mean_distance_m", "vfa.paper.nominal_unsafe.safe"]),
        ("vpa", ["vpa.paper.ratio", "vpa.paper.median_error", "vpa.paper.regret"]),
        ("dense", ["vfa.dense.perfect", "vpa.dense.regret", "vfa.dense.leg.FL.safe", "vfa.dense.terrain.stairs.safe"]),
    ):
        lines = list(
            eval_foothold("vpa" if name == "vpa" else "vfa", runs / name, data / "fresh", settings, tmp_path / name)
        )
        results = json.loads((tmp_path / name / "results.json").read_text())
        assert set(expected) <= set(results["metrics"])
        assert any(expected[0] in line for line in lines)
        assert "Loss while training" in (tmp_path / name / "report.html").read_text()
        for key, entry in results["metrics"].items():
            if key.endswith((".perfect", ".safe", ".regret")):
                assert 0 <= entry["value"] <= 1
    with pytest.raises(DatasetError, match="was trained on"):
        list(eval_foothold("vfa", runs / "vfa", data / "train", settings, tmp_path / "again"))
    with pytest.raises(DatasetError, match=r"a run of train vpa; measure it with legtool eval vpa"):
        list(eval_foothold("vfa", runs / "vpa", data / "fresh", settings, tmp_path / "other"))


def test_without_data_fresh_terrain_is_drawn_and_is_the_same_each_time(runs, tmp_path):
    settings = FootholdEvalSettings(vfa_samples=1000, vpa_samples=1000, bootstrap=100)
    results = []
    for place in ("one", "two"):
        list(eval_foothold("vfa", runs / "vfa", None, settings, tmp_path / place))
        results.append(json.loads((tmp_path / place / "results.json").read_text()))
    assert results[0] == results[1]
    assert results[0]["metrics"]["vfa.paper.perfect"]["n"] == 1000


def test_a_perfect_network_scores_perfectly(data, runs, monkeypatch):
    import legtool.evaluation.foothold as module

    samples, _ = load_footholds([data / "fresh"])
    run, settings = load_foothold_run(runs / "vfa"), FootholdEvalSettings(bootstrap=100)
    around = samples.take(samples.vpa == 0)
    monkeypatch.setattr(module, "proposals", lambda run, data: data.optimal.astype(np.int64))
    best = module.vfa_metrics(run, around, settings)
    assert best["vfa.paper.perfect"]["value"] == 1 and best["vfa.paper.mean_distance_m"]["value"] == 0
    monkeypatch.setattr(module, "proposals", lambda run, data: np.where(data.optimal < 0, 5, data.optimal))
    worse = module.vfa_metrics(run, around, settings)
    assert worse["vfa.paper.safe"]["value"] == pytest.approx((around.optimal >= 0).mean())
    below = samples.take(samples.vpa == 1)
    monkeypatch.setattr(module, "predicted_counts", lambda run, data: data.counts * 1.1)
    counts = module.vpa_metrics(run, below, settings)
    assert counts["vpa.paper.ratio"]["value"] == pytest.approx(1.1)
    assert counts["vpa.paper.median_error"]["value"] == pytest.approx(0.1)
    assert counts["vpa.paper.regret"]["value"] == 0


def test_what_is_no_run_or_no_such_data_is_told(data, tmp_path):
    with pytest.raises(DatasetError, match="not a run"):
        load_foothold_run(tmp_path)
    collect_footholds(FootholdSettings(samples=1000, vpa_share=0.0, seed=3), tmp_path / "around")
    with pytest.raises(DatasetError, match="no samples for vpa"):
        list(train_foothold("vpa", [tmp_path / "around"], FootholdTrainSettings(**SMALL), tmp_path / "run"))
