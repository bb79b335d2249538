"""Shared by all tests: where the real data lies, and a bundle learned from a short real sweep."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real logs beside the repository; absent in a plain clone."""
    if not SHARED.is_dir():
        pytest.skip("real robot logs are not beside this checkout (../shared/data)")
    return SHARED


@pytest.fixture(scope="session")
def walking_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two simulated minutes, forward commands alone, the chosen model alone: the others take most of a fit's time."""
    from legtool.configs.export import ExportSettings
    from legtool.configs.motion import MotionTrainSettings
    from legtool.configs.sweep import SweepSettings
    from legtool.datasets.motion.run import FittedMotion, save_run
    from legtool.datasets.motion.samples import load_transitions, motion_data
    from legtool.models.motion import build
    from legtool.pipeline.sweep import collect_sweep
    from legtool.training.export import export_bundle

    root = tmp_path_factory.mktemp("walking")
    collect_sweep(SweepSettings(episodes=6, episode_s=20, seed=3), root / "data")
    loaded = load_transitions([root / "data"])
    steps = motion_data(loaded.table)
    frozen = {
        name: build("bayesian", "full", folds=3).fit(steps.features, target).frozen()
        for name, target in steps.targets.items()
    }
    fitted = FittedMotion(
        robot=loaded.robot,
        instant=loaded.instant,
        formulation="full",
        estimator="bayesian",
        settings=MotionTrainSettings(folds=3).to_dict(),
        data={"steps": len(steps), **loaded.info},
        scores={},
        models={"bayesian": {"full": frozen}},
    )
    save_run(fitted, root / "run")
    return export_bundle([root / "run"], root / "bundle", ExportSettings(states=1000))
