import pytest
import yaml

from legtool.configs.mjcf import MjcfNames
from legtool.configs.policies import JOINT_NAMES
from legtool.configs.robots import PRESETS
from legtool.datasets.contents import bundle_content, controller_content, files_content, mjcf_content, robot_content
from legtool.datasets.work import digest
from legtool.errors import RobotError, SettingsError


def test_files_are_known_by_name_and_bytes_wherever_they_lie(tmp_path):
    for root in ("a", "b"):
        (tmp_path / root / "log").mkdir(parents=True)
        (tmp_path / root / "log" / "one.csv").write_text("1")
    assert files_content(tmp_path / "a" / "log") == files_content(tmp_path / "b" / "log")
    assert [entry["name"] for entry in files_content(tmp_path / "a" / "log")] == ["log/one.csv"]
    (tmp_path / "b" / "log" / "one.csv").write_text("2")
    assert files_content(tmp_path / "a" / "log") != files_content(tmp_path / "b" / "log")


def test_a_robot_is_its_yaml_and_not_its_name(tmp_path):
    (tmp_path / "copy.yaml").write_text((PRESETS / "go2.yaml").read_text())
    assert robot_content(str(tmp_path / "copy.yaml")) == robot_content("go2")
    settings = yaml.safe_load((PRESETS / "go2.yaml").read_text())
    settings["trunk"]["mass"] += 1
    (tmp_path / "copy.yaml").write_text(yaml.safe_dump(settings))
    assert robot_content(str(tmp_path / "copy.yaml")) != robot_content("go2")
    with pytest.raises(RobotError, match="no such preset"):
        robot_content("cow")


MJCF = """
<mujoco>
  <compiler meshdir="meshes" texturedir="."/>
  <include file="legs/legs.xml"/>
  <asset><mesh file="trunk.stl"/><texture type="cube" fileright="sky.png" builtin="none"/></asset>
</mujoco>
"""


@pytest.mark.parametrize("changed", ["dog.xml", "legs/legs.xml", "meshes/trunk.stl", "sky.png", "meshes/shank.obj"])
def test_an_mjcf_file_is_all_that_it_is_made_of(changed, tmp_path):
    contents = {
        "dog.xml": MJCF,
        "legs/legs.xml": '<mujoco><asset><mesh name="shank" file="shank.obj"/></asset></mujoco>',
        "meshes/trunk.stl": "solid",
        "meshes/shank.obj": "v 0 0 0",
        "sky.png": "blue",
        "notes.txt": "nothing to do with it",
    }
    for name, text in contents.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    found = mjcf_content(tmp_path / "dog.xml")
    assert [entry["name"] for entry in found] == sorted(set(contents) - {"notes.txt"})
    file = tmp_path / changed
    file.write_text(file.read_text() + "\n")
    assert mjcf_content(tmp_path / "dog.xml") != found


def test_names_of_an_mjcf_robot_belong_to_it_and_its_yaml_does_not(tmp_path):
    (tmp_path / "dog.xml").write_text("<mujoco/>")
    one, other = (robot_content("go2", tmp_path / "dog.xml", MjcfNames(standing_height=h)) for h in (0.3, 0.31))
    assert one != other
    assert robot_content("hyq", tmp_path / "dog.xml", MjcfNames(standing_height=0.3)) == one


def test_a_policy_is_its_description_and_its_network(tmp_path):
    description = {
        "onnx": "policy.onnx", "rate_hz": 50, "observation": ["command"], "joint_order": list(JOINT_NAMES),
        "home": [0.0] * 12, "action_scale": 0.25, "stiffness": 20, "damping": 0.5,
    }  # fmt: skip
    path = tmp_path / "policy.yaml"
    path.write_text(yaml.safe_dump(description))
    (tmp_path / "policy.onnx").write_bytes(b"network")
    (tmp_path / "policy.onnx.data").write_bytes(b"weights")
    seen = [digest(controller_content(str(path)))]
    (tmp_path / "policy.onnx").write_bytes(b"another network")
    seen.append(digest(controller_content(str(path))))
    (tmp_path / "policy.onnx.data").write_bytes(b"other weights")
    seen.append(digest(controller_content(str(path))))
    path.write_text(yaml.safe_dump(description | {"stiffness": 21}))
    seen.append(digest(controller_content(str(path))))
    assert len(set(seen)) == 4
    assert str(tmp_path) not in str(controller_content(str(path)))
    with pytest.raises(SettingsError, match="no such file"):
        controller_content(str(tmp_path / "none.yaml"))
    assert controller_content(None) is None


def test_a_class_is_its_module_and_what_that_imports_from_beside_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walker.py").write_text(
        "import numpy as np\nfrom gains import STIFF\nimport parts.legs\nclass Walk: ..."
    )
    (tmp_path / "gains.py").write_text("STIFF = 1")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "legs.py").write_text("LEGS = 4")
    (tmp_path / "unused.py").write_text("")
    found = controller_content("walker:Walk")
    names = [entry["name"] for entry in found["sources"]]
    assert names == ["gains.py", "parts/legs.py", "walker.py"]
    assert controller_content("walker:Run") != found
    (tmp_path / "gains.py").write_text("STIFF = 2")
    assert controller_content("walker:Walk") != found
    (tmp_path / "parts" / "__init__.py").write_text("")
    assert [entry["name"] for entry in controller_content("parts.legs:Walk")["sources"]] == [
        "parts/__init__.py",
        "parts/legs.py",
    ]
    assert controller_content("nowhere:Walk")["sources"] == []


def test_a_bundle_is_its_models_whoever_exported_them():
    line = {"instant": "touchdown", "provenance": {"commit": "a"}, "evaluation": {}, "agreement": {}}
    files = [{"name": "CARD.md", "sha256": "1"}, {"name": "motion.npz", "sha256": "2"}]
    manifest = {"robot": {"name": "go2"}, "lines": {"motion": line}, "files": files, "provenance": {"commit": "a"}}
    again = {**manifest, "lines": {"motion": {**line, "provenance": {"commit": "b"}}}, "provenance": {"commit": "b"}}
    again["files"] = [{"name": "CARD.md", "sha256": "3"}, files[1]]
    assert bundle_content(again) == bundle_content(manifest)
    assert bundle_content({**manifest, "files": [files[0], {**files[1], "sha256": "4"}]}) != bundle_content(manifest)
