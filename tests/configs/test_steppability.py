import pytest

from legtool.configs.settings import load
from legtool.configs.steppability import PRESETS, SteppabilityTrainSettings
from legtool.errors import SettingsError


def test_the_full_preset_loads_and_is_larger_than_the_default():
    full, default = load(SteppabilityTrainSettings, PRESETS / "full.yaml"), SteppabilityTrainSettings()
    assert full.network.width > default.network.width and full.epochs > default.epochs and full.bf16


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("coarse_epochs=12", "fewer than the 12 epochs"),
        ("network.encoder=vgg", "resnet"),
        ("network.depth=19", "18"),
        ("network.width=10", "multiple of 4"),
        ("lr=1", "unknown setting 'lr'"),
    ],
)
def test_settings_out_of_range_are_named(override, message):
    with pytest.raises(SettingsError, match=message):
        load(SteppabilityTrainSettings, None, [override])
