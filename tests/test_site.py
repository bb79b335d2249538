"""The site builds without a warning, so no link within it is broken; what stands around it is checked here, too."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft7Validator

from legtool.cli import COMMANDS
from legtool.command import Command

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "runtime" / "README.md"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site without the Python API, which takes minutes; make docs builds all of it."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", "-t", "quick", "-b", "html"]
    done = subprocess.run(
        [*command, "-d", str(out / "trees"), str(ROOT / "docs"), str(out / "html")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out / "html"


def test_a_broken_link_would_fail_the_build(site: Path, tmp_path: Path) -> None:
    for name in ("conf.py", "reference.py"):
        (tmp_path / name).write_text((ROOT / "docs" / name).read_text())
    (tmp_path / "static").symlink_to(ROOT / "docs" / "static")
    (tmp_path / "bundle.schema.json").write_text("{}")
    (tmp_path / "index.md").write_text("# Page\n\n[there](nowhere.md)\n\n```{toctree}\ngenerated/api\n```\n")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "-t", "quick", "-b", "dummy", str(tmp_path)]
    done = subprocess.run([*command, str(tmp_path / "out")], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "nowhere.md" in done.stderr


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_command_is_on_the_page_with_its_options(site: Path, command: Command) -> None:
    page = (site / "generated" / "commands.html").read_text()
    section = page.partition(f'id="{command.name.replace(" ", "-")}"')[2].partition("<section")[0]
    for option in command.options:
        assert option.name in section, option.name


@pytest.mark.parametrize(
    ("key", "row"),
    [
        ("planner.margin_m", ("number", "")),
        ("noise.position", ("number, ≥ 0, ≤ 0.1", "0.0015")),
        ("thigh_length", ("number, &gt; 0, ≤ 1.5", "must be given")),
        ("stones[].side", ("null or number", "null")),
    ],
)
def test_settings_are_there_with_types_bounds_and_defaults(site: Path, key: str, row: tuple[str, str]) -> None:
    page = (site / "generated" / "settings.html").read_text()
    cells = re.search(rf">{re.escape(key)}</span></code></p></td>(.*?)</tr>", page, re.DOTALL)
    assert cells is not None
    text = re.sub(r"<[^>]+>", "", cells[1])
    assert all(part in text for part in row), text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_to_files_and_headings_that_are_there(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, heading = target.partition("#")
        if name.startswith("generated/"):  # made with the site, which checks them
            assert page.parent == ROOT / "docs"
            continue
        path = (page.parent / name).resolve() if name else page
        assert path.is_file(), f"{page.name}: {target}"
        if heading:
            headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            assert heading in {re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in headings}, target


@pytest.mark.parametrize("picture", sorted((ROOT / "docs" / "images").iterdir()), ids=lambda path: path.name)
def test_pictures_are_small_and_shown(picture: Path) -> None:
    assert picture.stat().st_size <= (150_000 if picture.suffix == ".png" else 1_500_000)
    assert any(f"images/{picture.name}" in page.read_text() for page in PAGES)


def test_the_citation_is_as_its_schema_says_and_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    schema = json.loads((ROOT / "tests" / "cff_schema_1.2.0.json").read_text())
    Draft7Validator(schema).validate(citation)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert citation["authors"] == [{"name": "legtool developers"}]


def test_the_acronyms_of_the_code_are_in_the_glossary() -> None:
    glossary = (ROOT / "docs" / "glossary.md").read_text()
    for name in ("FDM", "CDM", "CVM", "MLR", "FEC", "VFA", "VPA", "TBR", "ViTAL", "QuadPiPS", "MCAP", "MJCF", "SLIC"):
        assert re.search(rf"^(?:.*, )?{name}(?:, .*)?\n: ", glossary, re.MULTILINE), name


#: What an acronym stands for, as pages that use it have to say once.
SPELLED = {
    "FDM": "displacement of the (swing )?feet|(footstep|swing-foot) displacement",
    "CDM": "CoM displacement|displacement of the CoM|feet and of the CoM|CoM .* displacement|the centre of mass goes",
    "CVM": "CoM velocity|velocity of the CoM|CoM-velocity|how fast it is after",
    "CoM": "centre of mass",
    "RMSE": "root (of the )?mean",
    "MAE": "mean absolute",
    "FEC": "foothold evaluation criteria",
    "VFA": "vision-based foothold|places a leg takes|choose footholds",
    "VPA": "vision-based pose|pose the body|body poses",
    "TBR": "terrain-based body",
    "CNN": "convolutional",
    "IoU": "intersection over union",
    "SLIC": "linear iterative clustering",
    "RANSAC": "random sample consensus",
    "MPC": "model predictive",
}


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=lambda page: page.name)
def test_acronyms_are_spelled_out_once_on_a_page(page: Path) -> None:
    text = " ".join(page.read_text().split())
    for acronym, words in SPELLED.items():
        if re.search(rf"\b{acronym}\b", text):
            assert re.search(words, text, re.IGNORECASE), f"{page.name}: {acronym}"
